//! Keyboard, mouse and touch screen of a window.

mod keys;
mod source;

pub use source::{DesktopConfig, DesktopFeed, DesktopSource};

use crate::found::Found;

/// What `--device` takes for the window of [`DesktopSource::open`]; it is not listed, since nobody plugged it in.
pub const DESKTOP: &str = "desktop";

pub(crate) fn found() -> Found {
    Found {
        streams: source::own_streams(false).into_iter().map(|s| s.name).collect(),
        ..Found::new(DESKTOP, DESKTOP.to_owned())
    }
}
