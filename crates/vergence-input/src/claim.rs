//! Which nodes this process reads: of two devices of one kind, the loss of one must not make its reader take the other.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

static READ: Mutex<BTreeMap<String, usize>> = Mutex::new(BTreeMap::new());

/// As long as it is kept, the node counts as read.
#[derive(Debug)]
pub(crate) struct Claim(String);

impl Claim {
    pub(crate) fn on(path: &str) -> Self {
        *READ.lock().unwrap_or_else(PoisonError::into_inner).entry(path.to_owned()).or_default() += 1;
        Self(path.to_owned())
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        let mut read = READ.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = read.get_mut(&self.0) {
            *count -= 1;
            if *count == 0 {
                read.remove(&self.0);
            }
        }
    }
}

/// Whether somebody reads it.
pub(crate) fn is_claimed(path: &str) -> bool {
    READ.lock().unwrap_or_else(PoisonError::into_inner).contains_key(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_claim_ends_with_its_last_holder() {
        let (first, second) = (Claim::on("/dev/none"), Claim::on("/dev/none"));
        drop(first);
        assert!(is_claimed("/dev/none"));
        drop(second);
        assert!(!is_claimed("/dev/none"));
    }
}
