//! The window itself, shared between the event loop and a surface.

use raw_window_handle::{DisplayHandle, HandleError, HasDisplayHandle, HasWindowHandle, WindowHandle};
use winit::dpi::PhysicalSize;
use winit::window::CursorGrabMode;

/// A window that a surface can be made on; it is closed when the last holder lets go.
pub struct Handle {
    window: winit::window::Window,
}

impl Handle {
    pub(crate) fn new(window: winit::window::Window) -> Self {
        Self { window }
    }

    /// Inner size in physical pixels.
    pub fn size(&self) -> (u32, u32) {
        let size = self.window.inner_size();
        (size.width, size.height)
    }

    pub(crate) fn screen(&self) -> Option<(u32, u32)> {
        let size = self.window.current_monitor()?.size();
        // Of a screen that is about to go, nothing is known.
        (size.width > 0 && size.height > 0).then_some((size.width, size.height))
    }

    pub(crate) fn set_title(&self, title: &str) {
        self.window.set_title(title);
    }

    pub(crate) fn confine(&self, on: bool) -> bool {
        let mode = if on { CursorGrabMode::Confined } else { CursorGrabMode::None };
        self.window.set_cursor_grab(mode).is_ok()
    }

    pub(crate) fn request_size(&self, size: (u32, u32)) {
        let _ = self.window.request_inner_size(PhysicalSize::new(size.0.max(1), size.1.max(1)));
    }
}

impl HasWindowHandle for Handle {
    fn window_handle(&self) -> Result<WindowHandle<'_>, HandleError> {
        self.window.window_handle()
    }
}

impl HasDisplayHandle for Handle {
    fn display_handle(&self) -> Result<DisplayHandle<'_>, HandleError> {
        self.window.display_handle()
    }
}
