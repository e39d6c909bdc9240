//! Poses as JSON lines: `{frame, predicted_display_ns, head: [x, y, z, qx, qy, qz, qw], eyes: [{pose: [7], fov: [l, r, u, d]}]}`
//! in LOCAL space, metres and radians; `head` is null where it is not known.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use vergence_geom::View;
use vergence_time::Timestamp;

use crate::Error;

/// A file of poses, one line per frame; each is on the disk when its frame is over, so that others can follow.
pub(crate) struct PoseLog {
    path: PathBuf,
    file: BufWriter<File>,
}

/// Left, right, up, down.
pub(crate) fn four(view: &View) -> [f64; 4] {
    let fov = view.fov;
    [fov.left_rad, fov.right_rad, fov.up_rad, fov.down_rad]
}

impl PoseLog {
    pub(crate) fn create(path: &Path) -> Result<Self, Error> {
        let file = File::create(path).map_err(Error::write(path))?;
        Ok(Self { path: path.to_owned(), file: BufWriter::new(file) })
    }

    /// Writes one frame. Numbers are written so that they read back exactly.
    pub(crate) fn write(
        &mut self,
        frame: u64,
        display: Timestamp,
        head: Option<[f64; 7]>,
        eyes: impl Iterator<Item = ([f64; 7], [f64; 4])>,
    ) -> Result<(), Error> {
        self.line(frame, display, head, eyes)
            .and_then(|()| self.file.flush())
            .map_err(Error::write(&self.path))
    }

    fn line(
        &mut self,
        frame: u64,
        display: Timestamp,
        head: Option<[f64; 7]>,
        eyes: impl Iterator<Item = ([f64; 7], [f64; 4])>,
    ) -> std::io::Result<()> {
        let Self { file, .. } = self;
        write!(file, "{{\"frame\":{frame},\"predicted_display_ns\":{},\"head\":", display.as_nanos())?;
        match head {
            Some(head) => numbers(file, &head)?,
            None => file.write_all(b"null")?,
        }
        file.write_all(b",\"eyes\":[")?;
        for (index, (pose, fov)) in eyes.enumerate() {
            file.write_all(if index == 0 { b"{\"pose\":" } else { b",{\"pose\":" })?;
            numbers(file, &pose)?;
            file.write_all(b",\"fov\":")?;
            numbers(file, &fov)?;
            file.write_all(b"}")?;
        }
        file.write_all(b"]}\n")
    }

    /// What is not on the disk yet.
    pub(crate) fn finish(mut self) -> Result<(), Error> {
        self.file.flush().map_err(Error::write(&self.path))
    }
}

fn numbers(file: &mut impl Write, values: &[f64]) -> std::io::Result<()> {
    for (index, value) in values.iter().enumerate() {
        file.write_all(if index == 0 { b"[" } else { b"," })?;
        // `{:?}` gives the shortest text that reads back to the same number; a pose is finite.
        write!(file, "{value:?}")?;
    }
    file.write_all(b"]")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_json_and_read_back_exactly() {
        let path = std::env::temp_dir().join(format!("vergence-pose-log-{}.jsonl", std::process::id()));
        let mut log = PoseLog::create(&path).unwrap();
        let head = [0.1, f64::from(0.2f32), -1e-300, 0.0, 0.0, 0.0, 1.0];
        log.write(7, Timestamp::from_nanos(-5), Some(head), [(head, [-0.9, 0.7, 0.8, -0.8])].into_iter())
            .unwrap();
        log.write(8, Timestamp::from_nanos(6), None, std::iter::empty()).unwrap();
        log.finish().unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        let lines: Vec<serde_json::Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
        assert_eq!(
            lines[0]["head"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect::<Vec<_>>(),
            head
        );
        assert_eq!((lines[0]["predicted_display_ns"].as_i64(), lines[1]["head"].is_null()), (Some(-5), true));
    }
}
