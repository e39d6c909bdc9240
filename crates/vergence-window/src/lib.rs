#![doc = include_str!("../README.md")]
#![warn(missing_docs)]

mod event;
mod handle;

use std::cell::RefCell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use raw_window_handle::{HasDisplayHandle, RawDisplayHandle};
use winit::dpi::PhysicalSize;
use winit::event_loop::{EventLoop, EventLoopBuilder};
use winit::platform::pump_events::{EventLoopExtPumpEvents, PumpStatus};

pub use event::{Event, PointerButton};
pub use handle::Handle;

/// Why there is no window.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// There is no display to open a window on.
    #[error("no display to open a window on ({detail}); set DISPLAY, or run without a window")]
    NoDisplay {
        /// What is missing.
        detail: String,
    },
    /// A library of the window system is not installed.
    #[error("the library {name} is missing; install it with `apt-get install {package}`")]
    MissingLibrary {
        /// File name of the library.
        name: &'static str,
        /// Debian's package with it.
        package: &'static str,
    },
    /// Another thread has this process's only event loop.
    #[error("expected windows of one thread only, found another thread that has had one")]
    OtherThread,
    /// The window system refused.
    #[error("the window could not be opened: {detail}")]
    Refused {
        /// What it said.
        detail: String,
    },
}

thread_local! {
    /// The event loop between two windows: a process can make only one.
    static IDLE_LOOP: RefCell<Option<EventLoop<()>>> = const { RefCell::new(None) };
}

/// A window, open until it is dropped.
pub struct Window {
    event_loop: Option<EventLoop<()>>,
    handle: Arc<Handle>,
    state: event::State,
}

impl Window {
    /// Opens a window with an inner size in physical pixels (the window manager may choose another one: see [`Window::size`]).
    ///
    /// # Errors
    ///
    /// No display, a missing library, a thread other than that of earlier windows, or a refusal by the window system.
    pub fn open(title: &str, size: (u32, u32)) -> Result<Self, Error> {
        // The window system's library panics where a shared library is missing; it is asked first, and caught all the same.
        let opened = catch_unwind(AssertUnwindSafe(|| Self::open_or_panic(title, size)));
        opened.unwrap_or_else(|panic| Err(Error::Refused { detail: panic_text(panic.as_ref()) }))
    }

    fn open_or_panic(title: &str, size: (u32, u32)) -> Result<Self, Error> {
        let mut event_loop = match IDLE_LOOP.take() {
            Some(event_loop) => event_loop,
            None => new_loop()?,
        };
        let attributes = winit::window::Window::default_attributes()
            .with_title(title)
            .with_inner_size(PhysicalSize::new(size.0.max(1), size.1.max(1)));
        let mut opener = event::Opener { attributes, result: None };
        event_loop.pump_app_events(Some(Duration::ZERO), &mut opener);
        let window = match opener.result {
            Some(Ok(window)) => window,
            other => {
                IDLE_LOOP.set(Some(event_loop));
                let detail = match other {
                    Some(Err(error)) => without_place(&error.to_string()),
                    _ => "the event loop did not start".into(),
                };
                return Err(Error::Refused { detail });
            }
        };
        let state = event::State::new(window.id());
        Ok(Self { event_loop: Some(event_loop), handle: Arc::new(Handle::new(window)), state })
    }

    /// Passes on what happened since the last call, oldest first; does not wait.
    pub fn poll(&mut self, mut tell: impl FnMut(Event)) {
        self.pump(Duration::ZERO, &mut tell);
    }

    /// As [`Window::poll`], but waits up to `longest` for something to happen.
    pub fn wait(&mut self, longest: Duration, mut tell: impl FnMut(Event)) {
        self.pump(longest, &mut tell);
    }

    fn pump(&mut self, longest: Duration, tell: &mut dyn FnMut(Event)) {
        if let Some(event_loop) = &mut self.event_loop {
            let mut listener = event::Listener { state: &mut self.state, tell };
            if let PumpStatus::Exit(_) = event_loop.pump_app_events(Some(longest), &mut listener) {
                (listener.tell)(Event::CloseRequested);
            }
        }
    }

    /// Inner size in physical pixels.
    pub fn size(&self) -> (u32, u32) {
        self.handle.size()
    }

    /// Size in physical pixels of the screen that the window is on; `None` where the window system does not say.
    pub fn screen(&self) -> Option<(u32, u32)> {
        self.handle.screen()
    }

    /// Changes the title.
    pub fn set_title(&self, title: &str) {
        self.handle.set_title(title);
    }

    /// Keeps the pointer inside of the window, as a screen keeps it, or lets it go. Whether the window system does: it may refuse
    /// while the window is not shown or another one has the pointer.
    pub fn confine(&self, on: bool) -> bool {
        self.handle.confine(on)
    }

    /// Asks for another inner size, in physical pixels; an [`Event::Resized`] tells what came of it.
    pub fn request_size(&self, size: (u32, u32)) {
        self.handle.request_size(size);
    }

    /// The window for a surface. The window stays on screen while somebody holds it.
    pub fn handle(&self) -> Arc<Handle> {
        Arc::clone(&self.handle)
    }

    /// The display for a Vulkan instance; `None` if the window system has gone away.
    pub fn display(&self) -> Option<RawDisplayHandle> {
        self.handle.display_handle().ok().map(|display| display.as_raw())
    }
}

impl Drop for Window {
    fn drop(&mut self) {
        // Not while the thread itself ends: its storage is gone then.
        if let Some(event_loop) = self.event_loop.take() {
            let _ = IDLE_LOOP.try_with(|idle| idle.replace(Some(event_loop)));
        }
    }
}

fn new_loop() -> Result<EventLoop<()>, Error> {
    #[cfg(target_os = "linux")]
    if xkbcommon_dl::x11::xkbcommon_x11_option().is_none() {
        return Err(Error::MissingLibrary { name: "libxkbcommon-x11.so.0", package: "libxkbcommon-x11-0" });
    }
    let mut builder: EventLoopBuilder<()> = EventLoop::builder();
    #[cfg(target_os = "linux")]
    {
        use winit::platform::x11::EventLoopBuilderExtX11;
        builder.with_any_thread(true);
    }
    // The library refuses a second attempt even after a failed first one: the first answer stays the answer.
    static FAILED: OnceLock<Error> = OnceLock::new();
    builder.build().map_err(|error| match error {
        winit::error::EventLoopError::RecreationAttempt => {
            FAILED.get().cloned().unwrap_or(Error::OtherThread)
        }
        _ => FAILED.get_or_init(|| Error::NoDisplay { detail: absent_display() }).clone(),
    })
}

/// Why there is no display, in the user's words: the window system's library speaks of variables that are not used here.
fn absent_display() -> String {
    match std::env::var_os("DISPLAY") {
        Some(name) if !name.is_empty() => format!("nobody answers at DISPLAY={}", name.to_string_lossy()),
        _ => "DISPLAY is not set".into(),
    }
}

/// What the window system's library said, without the line of its source that said it (`os error at FILE:LINE: WHAT`).
fn without_place(text: &str) -> String {
    let what = text.strip_prefix("os error at ").and_then(|rest| {
        let (_, rest) = rest.split_once(".rs:")?;
        Some(rest.trim_start_matches(|c: char| c.is_ascii_digit()).trim_start_matches(": "))
    });
    what.unwrap_or(text).to_owned()
}

fn panic_text(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("the window system panicked").into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn where_a_library_was_built_is_nobodys_business() {
        let said =
            "os error at /home/somebody/.cargo/winit-0.30/src/linux/mod.rs:788: Failed to open connection";
        assert_eq!(without_place(said), "Failed to open connection");
        assert_eq!(without_place("a sentence: as it is"), "a sentence: as it is");
    }
}
