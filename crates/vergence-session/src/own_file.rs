//! What is written must not be what is read: the file would be gone before it is read to its end.

use std::path::{Path, PathBuf};

use crate::error::Error;

/// Refuses `output` where it is one of the files that are `read`, by whatever name, link or hard link. A folder that is read
/// is not looked into. `option` is what the user calls the output.
///
/// # Errors
/// [`Error::Call`] with the option and the path.
pub fn own_file(option: &str, output: &Path, read: &[PathBuf]) -> Result<(), Error> {
    if read.iter().any(|read| is_same(output, read)) {
        return Err(Error::Call(format!(
            "{option} {}: expected a file of its own, found one that is read, or written, by this very call",
            output.display()
        )));
    }
    Ok(())
}

/// Also of files that are not there yet; devices and pipes are nobody's own.
fn is_same(a: &Path, b: &Path) -> bool {
    match (a.metadata(), b.metadata()) {
        (Ok(a_is), Ok(b_is)) => a_is.is_file() && is_same_file((a, &a_is), (b, &b_is)),
        (Err(_), Err(_)) => match (place(a), place(b)) {
            (Some(a), Some(b)) => a == b,
            _ => false,
        },
        _ => false,
    }
}

#[cfg(unix)]
fn is_same_file((_, a): (&Path, &std::fs::Metadata), (_, b): (&Path, &std::fs::Metadata)) -> bool {
    use std::os::unix::fs::MetadataExt;
    (a.dev(), a.ino()) == (b.dev(), b.ino())
}

#[cfg(not(unix))]
fn is_same_file((a, _): (&Path, &std::fs::Metadata), (b, _): (&Path, &std::fs::Metadata)) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

/// Where a file will be that is not there yet; `None` where its folder is not there either.
fn place(path: &Path) -> Option<PathBuf> {
    let folder = match path.parent()? {
        folder if folder.as_os_str().is_empty() => Path::new("."),
        folder => folder,
    };
    Some(folder.canonicalize().ok()?.join(path.file_name()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_known_by_every_name() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("read.csv"), "1").unwrap();
        std::fs::write(at("other.csv"), "1").unwrap();
        std::fs::create_dir(at("inner")).unwrap();
        std::fs::hard_link(at("read.csv"), at("hard.csv")).unwrap();
        let mut names = vec![at("read.csv"), at("inner/../read.csv"), at("hard.csv")];
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(at("read.csv"), at("soft.csv")).unwrap();
            names.push(at("soft.csv"));
        }
        for name in &names {
            let refused = own_file("--out", name, &[at("other.csv"), at("read.csv")]).unwrap_err();
            assert!(refused.is_wrong_call() && refused.to_string().starts_with("--out "), "{refused}");
        }
        for name in ["other.csv", "new.csv", "inner", "absent/new.csv"] {
            own_file("--out", &at(name), &[at("read.csv"), at("")]).unwrap();
        }
        // Two outputs, neither there yet.
        assert!(own_file("--out", &at("new.csv"), &[at("inner/../new.csv")]).is_err());
        #[cfg(unix)]
        own_file("--out", Path::new("/dev/null"), &["/dev/null".into()]).unwrap();
    }
}
