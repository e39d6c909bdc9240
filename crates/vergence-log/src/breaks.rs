//! Breaks in what a device says, as its own stream of events tells them.

use vergence_sense::Event;

/// Counts the gaps of one device by its events; this is what a gap of a device is, wherever gaps are counted: a recording's and a
/// replay's `gaps`, and those of a stream of events in a [`Survey`](crate::Survey). Numbers that are missing are one (`gap`, of any
/// length), and so is a time that the device was away (`connected`, again).
///
/// ```
/// use vergence_sense::Event;
/// let mut breaks = vergence_log::Breaks::default();
/// let missing = Event { after: 3.0, ..Event::new("gap", "") };
/// for event in [Event::new("connected", ""), missing, Event::new("disconnected", ""), Event::new("connected", "")] {
///     breaks.follow(&event);
/// }
/// assert_eq!((breaks.count(), breaks.missing()), (2, 3));
/// ```
#[derive(Clone, Copy, Debug, Default)]
pub struct Breaks {
    was_there: bool,
    count: u64,
    missing: u64,
}

impl Breaks {
    /// Takes one event of the device; whether it is a break.
    pub fn follow(&mut self, event: &Event) -> bool {
        let is_one = match &*event.name {
            "gap" => {
                self.missing = self.missing.saturating_add(event.after.max(0.0) as u64);
                true
            }
            // It was away until now.
            "connected" => std::mem::replace(&mut self.was_there, true),
            _ => false,
        };
        self.count += u64::from(is_one);
        is_one
    }

    /// Whether the device has been there.
    pub fn was_there(&self) -> bool {
        self.was_there
    }

    /// Gaps so far.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Numbers of the device's that were missing so far.
    pub fn missing(&self) -> u64 {
        self.missing
    }
}
