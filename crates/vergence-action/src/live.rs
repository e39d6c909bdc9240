//! Bindings that change with their file while they are at work.

use std::path::{Path, PathBuf};

use crate::bindings::{Bindings, Error};
use crate::mapper::Mapper;

/// A file of bindings at work. Whoever runs it looks every now and then whether the file has changed ([`LiveBindings::look`]).
#[derive(Debug)]
pub struct LiveBindings {
    path: PathBuf,
    bindings: Bindings,
    mapper: Mapper,
    /// What was read last, whether it could be used or not.
    text: String,
    /// What was found at the last look, where it was something else: editors write in pieces.
    found: Option<String>,
    /// How many looks in a row there was no file.
    missing: u8,
}

/// What has become of the file.
#[derive(Debug)]
pub enum Change {
    /// It was read anew and is at work.
    Read,
    /// It cannot be used; what was at work still is.
    Refused(Error),
}

impl LiveBindings {
    /// Reads the file.
    ///
    /// # Errors
    /// As [`Bindings::read`].
    pub fn open(path: &Path) -> Result<Self, Error> {
        let text = Bindings::text(path)?;
        let bindings = Bindings::parse(path, &text)?;
        let mapper = Mapper::new(&bindings)?;
        Ok(Self { path: path.to_owned(), bindings, mapper, text, found: None, missing: 0 })
    }

    /// What is at work.
    pub fn bindings(&self) -> &Bindings {
        &self.bindings
    }

    /// At work.
    pub fn mapper(&self) -> &Mapper {
        &self.mapper
    }

    /// To be fed.
    pub fn mapper_mut(&mut self) -> &mut Mapper {
        &mut self.mapper
    }

    /// Looks whether the file has changed; a few times a second is often enough. What is found twice alike counts. After
    /// [`Change::Read`], devices are wired anew: [`crate::Wiring::connect`].
    pub fn look(&mut self) -> Option<Change> {
        let text = match Bindings::text(&self.path) {
            Ok(text) => text,
            Err(error) => {
                // A file that is replaced is away for a moment; one that stays away is said once.
                self.missing = self.missing.saturating_add(1);
                self.found = None;
                return (self.missing == 2).then_some(Change::Refused(error));
            }
        };
        self.missing = 0;
        if text == self.text {
            self.found = None;
            return None;
        }
        if self.found.as_ref() != Some(&text) {
            self.found = Some(text);
            return None;
        }
        self.found = None;
        self.text = text;
        let read = Bindings::parse(&self.path, &self.text)
            .and_then(|bindings| self.mapper.replace(&bindings).map(|()| bindings).map_err(Error::from));
        match read {
            Ok(bindings) => {
                self.bindings = bindings;
                Some(Change::Read)
            }
            Err(error) => Some(Change::Refused(error)),
        }
    }
}

#[cfg(test)]
mod tests {
    use vergence_time::Timestamp;

    use super::*;
    use crate::{Reading, Value};

    const JUMP: &str = "[actions.jump]\nkind = \"button\"\nbind = [{ input = \"key.space\" }]\n";

    fn file(text: &str) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bindings.toml");
        std::fs::write(&path, text).unwrap();
        (folder, path)
    }

    fn press(live: &mut LiveBindings, input: &str, is_down: bool) -> Option<Value> {
        let mapper = live.mapper_mut();
        let input = mapper.input(input)?;
        mapper.feed(Timestamp::from_nanos(0), input, Reading::Button(is_down));
        mapper.value(mapper.action("jump")?).cloned()
    }

    #[test]
    fn a_file_that_changes_is_at_work_once_it_rests() {
        let (_folder, path) = file(JUMP);
        let mut live = LiveBindings::open(&path).unwrap();
        assert_eq!(press(&mut live, "key.space", true), Some(Value::Button(true)));
        assert!(live.look().is_none());
        let other = JUMP.replace("key.space", "key.j");
        std::fs::write(&path, &other).unwrap();
        assert!(live.look().is_none(), "it may still be written");
        assert!(matches!(live.look(), Some(Change::Read)));
        assert_eq!(press(&mut live, "key.space", true), None, "nobody watches it any more");
        assert_eq!(press(&mut live, "key.j", true), Some(Value::Button(true)));
        assert!(live.look().is_none());
    }

    #[test]
    fn a_file_that_cannot_be_used_leaves_the_old_bindings_at_work() {
        let (_folder, path) = file(JUMP);
        let mut live = LiveBindings::open(&path).unwrap();
        std::fs::write(&path, JUMP.replace("key.space", "pad.sout")).unwrap();
        assert!(live.look().is_none());
        let Some(Change::Refused(error)) = live.look() else { panic!("it is refused") };
        assert!(error.to_string().contains("bindings.toml:3"), "{error}");
        assert!(live.look().is_none(), "it is said once");
        assert_eq!(press(&mut live, "key.space", true), Some(Value::Button(true)));
        std::fs::remove_file(&path).unwrap();
        assert!(live.look().is_none());
        assert!(matches!(live.look(), Some(Change::Refused(_))));
        assert!(live.look().is_none() && live.look().is_none(), "it is said once");
        std::fs::write(&path, JUMP).unwrap();
        assert!(live.look().is_none());
        assert!(matches!(live.look(), Some(Change::Read)));
    }
}
