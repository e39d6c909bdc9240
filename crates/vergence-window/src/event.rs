//! What happens in a window, in our words; and the adapters that the event loop calls.

use vergence_sense::TouchPhase;
use winit::application::ApplicationHandler;
use winit::event::{DeviceEvent, DeviceId, ElementState, MouseButton, MouseScrollDelta, WindowEvent};
use winit::event_loop::ActiveEventLoop;
use winit::keyboard::PhysicalKey;
use winit::window::{WindowAttributes, WindowId};

/// Pixels of a touchpad that count as one line of a wheel.
const PIXELS_PER_LINE: f64 = 40.0;

/// A button of a pointing device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum PointerButton {
    /// Left.
    Left,
    /// Right.
    Right,
    /// Middle, or the wheel.
    Middle,
    /// Another one, by its number.
    Other(u16),
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// The window has another inner size, in physical pixels.
    Resized {
        /// Width.
        width: u32,
        /// Height.
        height: u32,
    },
    /// The user wants the window closed.
    CloseRequested,
    /// The window got or lost the keyboard.
    Focused(bool),
    /// A key went down or up.
    Key {
        /// Its place on the keyboard, by the W3C name: `KeyW`, `Space`, `ArrowUp`, `ShiftLeft`…
        key: String,
        /// Down or up.
        pressed: bool,
        /// Whether the keyboard repeats a key that is held.
        repeated: bool,
    },
    /// The pointer is at a place in the window, in physical pixels from its upper left corner.
    PointerAt {
        /// To the right.
        x: f64,
        /// Down.
        y: f64,
    },
    /// The pointer left the window.
    PointerLeft,
    /// The device moved, in its own unaccelerated counts, even where the pointer cannot; only while the window has the keyboard.
    PointerMoved {
        /// To the right.
        dx: f64,
        /// Down.
        dy: f64,
    },
    /// A button of the pointer went down or up.
    Button {
        /// Which.
        button: PointerButton,
        /// Down or up.
        pressed: bool,
    },
    /// A finger on a touch screen.
    Touch {
        /// Which: the same number from its first touch to its last.
        contact: u32,
        /// To the right, in physical pixels from the window's upper left corner.
        x: f64,
        /// Down.
        y: f64,
        /// What it does; a screen does not tell fingers that hover.
        phase: TouchPhase,
    },
    /// The wheel turned, in lines.
    Wheel {
        /// To the right.
        right: f64,
        /// Up (away from the user).
        up: f64,
    },
}

/// What must be known to pass events on.
pub(crate) struct State {
    window: WindowId,
    focused: bool,
}

impl State {
    pub fn new(window: WindowId) -> Self {
        Self { window, focused: false }
    }

    /// The event in our words; `None` for what we do not pass on.
    fn translate(&mut self, event: WindowEvent) -> Option<Event> {
        Some(match event {
            WindowEvent::Resized(size) => Event::Resized { width: size.width, height: size.height },
            WindowEvent::CloseRequested => Event::CloseRequested,
            WindowEvent::Focused(focused) => {
                self.focused = focused;
                Event::Focused(focused)
            }
            WindowEvent::KeyboardInput { event, is_synthetic: false, .. } => {
                let PhysicalKey::Code(code) = event.physical_key else { return None };
                // The names of the codes are the W3C's.
                Event::Key {
                    key: format!("{code:?}"),
                    pressed: event.state == ElementState::Pressed,
                    repeated: event.repeat,
                }
            }
            WindowEvent::CursorMoved { position, .. } => Event::PointerAt { x: position.x, y: position.y },
            WindowEvent::CursorLeft { .. } => Event::PointerLeft,
            WindowEvent::MouseInput { state, button, .. } => Event::Button {
                button: match button {
                    MouseButton::Left => PointerButton::Left,
                    MouseButton::Right => PointerButton::Right,
                    MouseButton::Middle => PointerButton::Middle,
                    MouseButton::Back => PointerButton::Other(8),
                    MouseButton::Forward => PointerButton::Other(9),
                    MouseButton::Other(number) => PointerButton::Other(number),
                },
                pressed: state == ElementState::Pressed,
            },
            WindowEvent::MouseWheel { delta, .. } => match delta {
                MouseScrollDelta::LineDelta(right, up) => {
                    Event::Wheel { right: f64::from(right), up: f64::from(up) }
                }
                MouseScrollDelta::PixelDelta(pixels) => {
                    Event::Wheel { right: pixels.x / PIXELS_PER_LINE, up: pixels.y / PIXELS_PER_LINE }
                }
            },
            WindowEvent::Touch(touch) => Event::Touch {
                // Window systems count contacts from some number on; what matters is that two at once differ.
                contact: touch.id as u32,
                x: touch.location.x,
                y: touch.location.y,
                phase: match touch.phase {
                    winit::event::TouchPhase::Started => TouchPhase::Begins,
                    winit::event::TouchPhase::Moved => TouchPhase::Moves,
                    winit::event::TouchPhase::Ended => TouchPhase::Ends,
                    winit::event::TouchPhase::Cancelled => TouchPhase::Cancelled,
                },
            },
            _ => return None,
        })
    }
}

/// Opens a window as soon as the event loop runs.
pub(crate) struct Opener {
    pub attributes: WindowAttributes,
    pub result: Option<Result<winit::window::Window, winit::error::OsError>>,
}

impl ApplicationHandler for Opener {
    fn resumed(&mut self, _: &ActiveEventLoop) {}

    fn new_events(&mut self, event_loop: &ActiveEventLoop, _: winit::event::StartCause) {
        if self.result.is_none() {
            self.result = Some(event_loop.create_window(self.attributes.clone()));
        }
    }

    fn window_event(&mut self, _: &ActiveEventLoop, _: WindowId, _: WindowEvent) {}
}

/// Passes the events of one window on.
pub(crate) struct Listener<'a> {
    pub state: &'a mut State,
    pub tell: &'a mut dyn FnMut(Event),
}

impl ApplicationHandler for Listener<'_> {
    fn resumed(&mut self, _: &ActiveEventLoop) {}

    fn window_event(&mut self, _: &ActiveEventLoop, window: WindowId, event: WindowEvent) {
        // Events of a window that was closed may still arrive.
        if window == self.state.window
            && let Some(event) = self.state.translate(event)
        {
            (self.tell)(event);
        }
    }

    fn device_event(&mut self, _: &ActiveEventLoop, _: DeviceId, event: DeviceEvent) {
        if let DeviceEvent::MouseMotion { delta: (dx, dy) } = event
            && self.state.focused
        {
            (self.tell)(Event::PointerMoved { dx, dy });
        }
    }
}

#[cfg(test)]
mod tests {
    use winit::dpi::PhysicalPosition;

    use super::*;

    #[test]
    fn fingers_are_passed_on() {
        use winit::event::TouchPhase as Theirs;
        let mut state = State::new(WindowId::dummy());
        for (theirs, ours) in [
            (Theirs::Started, TouchPhase::Begins),
            (Theirs::Moved, TouchPhase::Moves),
            (Theirs::Ended, TouchPhase::Ends),
            (Theirs::Cancelled, TouchPhase::Cancelled),
        ] {
            let location = PhysicalPosition::new(3.5, 7.0);
            let touch = winit::event::Touch {
                device_id: DeviceId::dummy(),
                phase: theirs,
                location,
                force: None,
                id: 9,
            };
            let event = state.translate(WindowEvent::Touch(touch));
            assert_eq!(event, Some(Event::Touch { contact: 9, x: 3.5, y: 7.0, phase: ours }));
        }
    }
}
