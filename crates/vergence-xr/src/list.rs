//! The two-call idiom, against runtimes that count differently the second time.

use openxr::sys;

use crate::error::{Error, check};

/// More of anything than a runtime has; a larger count is a fault of the runtime.
const MOST: u32 = 10_000;
/// How often a list is asked for that keeps growing.
const TRIES: u32 = 5;

/// Reads a list: `get(capacity, count, items)` is asked for the count with no room, then for as many items. The list may
/// have become longer or shorter meanwhile. (The helper of the crate openxr panics or reads memory that nobody wrote
/// where a runtime's counts contradict each other, and never ends where it always wants more room.)
///
/// # Errors
/// What the runtime answers, a list without end, or one that is never short enough for the room that it asked for.
pub(crate) fn list<T: Copy>(
    call: &'static str,
    empty: T,
    mut get: impl FnMut(u32, &mut u32, *mut T) -> sys::Result,
) -> Result<Vec<T>, Error> {
    for _ in 0..TRIES {
        let mut count = 0;
        match get(0, &mut count, std::ptr::null_mut()) {
            sys::Result::ERROR_SIZE_INSUFFICIENT => continue,
            result => check(call, result)?,
        };
        if count > MOST {
            return Err(Error::Unsupported {
                what: call,
                expected: format!("at most {MOST}"),
                found: count.to_string(),
            });
        }
        if count == 0 {
            return Ok(Vec::new());
        }
        let room = count;
        let mut items = vec![empty; room as usize];
        match get(room, &mut count, items.as_mut_ptr()) {
            sys::Result::ERROR_SIZE_INSUFFICIENT => {}
            result => {
                check(call, result)?;
                items.truncate(count.min(room) as usize);
                return Ok(items);
            }
        }
    }
    Err(Error::Call { call, result: sys::Result::ERROR_SIZE_INSUFFICIENT })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A runtime whose answers are a script: count said, result.
    fn ask(script: &[(u32, sys::Result)]) -> Result<Vec<u8>, Error> {
        let mut answers = script.iter();
        list("xrEnumerate", 0u8, |capacity, count, items| {
            let (said, result) = *answers.next().unwrap_or(&script[script.len() - 1]);
            *count = said;
            for index in 0..capacity.min(said) {
                // SAFETY: the list has room for `capacity` items.
                unsafe { items.add(index as usize).write(7) };
            }
            result
        })
    }

    #[test]
    fn counts_that_change_between_the_two_calls_do_no_harm() {
        use sys::Result as R;
        let (ok, small) = (R::SUCCESS, R::ERROR_SIZE_INSUFFICIENT);
        assert_eq!(ask(&[(2, ok), (2, ok)]).unwrap(), [7, 7]);
        assert_eq!(ask(&[(3, ok), (2, ok)]).unwrap(), [7, 7]);
        assert_eq!(ask(&[(1, ok), (2, small), (2, ok), (2, ok)]).unwrap(), [7, 7]);
        // More said than there was room for: what was written counts.
        assert_eq!(ask(&[(1, ok), (9, ok)]).unwrap(), [7]);
        assert_eq!(ask(&[(0, small), (1, ok), (1, ok)]).unwrap(), [7]);
        assert!(ask(&[(0, ok)]).unwrap().is_empty());
    }

    #[test]
    fn lists_without_end_are_given_up() {
        use sys::Result as R;
        assert!(matches!(ask(&[(1, R::SUCCESS), (1, R::ERROR_SIZE_INSUFFICIENT)]), Err(Error::Call { .. })));
        assert!(matches!(ask(&[(0, R::ERROR_SIZE_INSUFFICIENT)]), Err(Error::Call { .. })));
        assert!(matches!(ask(&[(u32::MAX, R::SUCCESS)]), Err(Error::Unsupported { .. })));
        let lost = ask(&[(1, R::SUCCESS), (1, R::ERROR_SESSION_LOST)]);
        assert!(matches!(lost, Err(Error::SessionLost { call: "xrEnumerate" })));
    }
}
