//! What moves a simulated headset, by name.

use std::path::Path;
use std::sync::Arc;

use vergence_xr_sim::{PoseProvider, motion};

use crate::error::Error;
use crate::odometry;
use crate::replay::SessionLog;
use crate::report::OdometryReport;

/// A motion by its name: a recorded session (`.mcap`), our own tracking of a recorded rig (`slam:DATASET`, followed to its end
/// here unless `is_stopped`), or as [`motion::open`]. What takes its time is said.
///
/// # Errors
/// A log, recording or file that cannot be read; a name that is none.
pub fn open_motion(
    name: &str,
    is_stopped: &dyn Fn() -> bool,
    say: &mut dyn FnMut(&str),
) -> Result<Arc<dyn PoseProvider>, Error> {
    open_followed(name, is_stopped, say).map(|(motion, _)| motion)
}

/// As [`open_motion`], with how the odometry went where it is one.
pub(crate) fn open_followed(
    name: &str,
    is_stopped: &dyn Fn() -> bool,
    say: &mut dyn FnMut(&str),
) -> Result<(Arc<dyn PoseProvider>, Option<OdometryReport>), Error> {
    if name.ends_with(".mcap") {
        Ok((Arc::new(SessionLog::open(Path::new(name))?.motion()?), None))
    } else if let Some(folder) = odometry::folder(name) {
        let (motion, report) = odometry::motion(folder, is_stopped, say)?;
        Ok((Arc::new(motion), Some(report)))
    } else {
        Ok((Arc::from(motion::open(name)?), None))
    }
}
