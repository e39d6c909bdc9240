//! Where orientations go: a file, compressed where its name ends with `.gz`, or stdout for `-`.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;
use vergence_inertial::write_orientations;

use super::truth::Stamped;
use crate::failure::Failure;

/// Whether it is stdout.
pub fn is_stdout(path: &Path) -> bool {
    path.as_os_str() == "-"
}

/// Writes `t_s,qw,qx,qy,qz`.
pub fn write(path: &Path, rows: impl Iterator<Item = Stamped>) -> Result<(), Failure> {
    let failed = |error: io::Error| Failure::Work(format!("{}: cannot be written: {error}", path.display()));
    if is_stdout(path) {
        return write_orientations(BufWriter::new(io::stdout().lock()), rows).map_err(failed);
    }
    let mut file = BufWriter::new(File::create(path).map_err(failed)?);
    if path.extension().is_some_and(|extension| extension == "gz") {
        let mut packed = GzEncoder::new(file, Compression::default());
        write_orientations(&mut packed, rows).map_err(failed)?;
        return packed.finish().and_then(|mut file| file.flush()).map_err(failed);
    }
    write_orientations(&mut file, rows).map_err(failed)
}
