//! A study in a window of this computer's screen.

use vergence_geom::{Fov, Rigid, View};
use vergence_gpu as gpu;
use vergence_render::{Offscreen, Quality, Renderer, Target as Picture};
use vergence_scene::Needs;
use vergence_session::Stop;
use vergence_study::{Geometry, Plane, Point, Study};
use vergence_time::{Clock as _, HostClock, Span, Timestamp};
use vergence_window::{Event, PointerButton, Window};

use crate::conduct::{Conduct, Ended};
use crate::course::{Goal, Reading, Showing, Step};
use crate::error::Error;
use crate::input::Input;
use crate::stimuli::{Stimuli, Words};
use crate::wearer::Actor;

/// How long the loop waits for something to happen: a cursor that rests is sampled so often.
const TICK: std::time::Duration = std::time::Duration::from_millis(5);
/// Around the targets, metres; above them there is room for words, too.
const MARGIN_M: f64 = 0.01;
const WORDS_M: f64 = 0.04;
const INCH_M: f64 = 0.0254;

/// What a sitting on the desktop needs to know beside its study.
#[derive(Clone, Debug)]
pub struct OnDesktop {
    /// What moves the cursor: the mouse, or a simulated person.
    pub input: Input,
    /// Pixels per inch of the screen.
    pub dpi: f64,
    /// Stops after so many trials.
    pub most_trials: Option<u64>,
    /// Ends the sitting from outside.
    pub stop: Stop,
}

/// Whether a study can be done so; the window that it takes, pixels.
///
/// # Errors
/// Which task or input does not go with a screen.
pub fn window_size(study: &Study, how: &OnDesktop) -> Result<(u32, u32), Error> {
    let refuse = |text: String| Err(Error::Call(text));
    if !matches!(how.input, Input::Mouse | Input::Simulated(_)) {
        return refuse(format!(
            "--input {0}: expected mouse or simulated:SEED on the desktop, found {0}",
            how.input
        ));
    }
    if !(10.0..=2000.0).contains(&how.dpi) {
        return refuse(format!("--dpi: expected 10 to 2000 pixels per inch, found {}", how.dpi));
    }
    match study.geometry {
        Geometry::Depth => {
            return refuse("a task in depth needs a headset: --headset openxr or simulated".into());
        }
        Geometry::Ring { plane, .. } if plane != Plane::Xy => {
            return refuse(
                "a ring that does not face the viewer (plane is not \"xy\") needs a headset".into(),
            );
        }
        _ => {}
    }
    let half = |size: &vergence_study::Size| {
        let (amplitude, width) = (0.5 * size.amplitude, 0.5 * size.width.unwrap_or(0.0));
        match study.geometry {
            Geometry::Ray { distance, .. } => distance * (amplitude + width).min(1.5).tan(),
            Geometry::Corner => amplitude * std::f64::consts::FRAC_1_SQRT_2,
            _ => amplitude + width,
        }
    };
    let reach = study.sizes.iter().map(half).fold(0.0, f64::max);
    let is_high = matches!(study.geometry, Geometry::Ring { .. } | Geometry::Ray { .. } | Geometry::Corner);
    let high = if is_high { reach } else { 0.1 };
    let pixels = |metres: f64| (metres / INCH_M * how.dpi).ceil().clamp(1.0, 16384.0) as u32;
    Ok((pixels(2.0 * (reach + MARGIN_M)), pixels(2.0 * (high + MARGIN_M + WORDS_M))))
}

/// The window of a sitting, opened before anything is written: where there is none, no log is left behind.
pub struct Desk {
    window: Window,
    screen: Screen,
    wanted: (u32, u32),
}

impl Desk {
    /// Opens it.
    ///
    /// # Errors
    /// No window, no device that draws in it, or a screen that is too small.
    pub fn open(study: &Study, how: &OnDesktop) -> Result<Self, Error> {
        let wanted = window_size(study, how)?;
        let window = Window::open(&study.name, wanted)?;
        // Without a window manager nobody makes a window as small as the screen.
        if let Some(found) = window.screen()
            && (found.0 < wanted.0 || found.1 < wanted.1)
        {
            return Err(too_small(wanted, found, how.dpi));
        }
        let screen = Screen::new(study, &window, how)?;
        Ok(Self { window, screen, wanted })
    }
}

/// Runs a sitting that was begun in its window, until everything is done, `most_trials` are, or the window is closed.
///
/// # Errors
/// A device that is lost, a window made too small, or a disk that takes no more. What was finished is on the disk, and the
/// folder knows why the sitting ended.
pub fn on_desktop(
    mut conduct: Conduct,
    desk: Desk,
    how: &OnDesktop,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<Ended, Error> {
    let ran = sit(&mut conduct, desk, how, progress);
    let why = match &ran {
        Ok(why) => why.clone(),
        Err(error) => error.to_string(),
    };
    let ended = conduct.finish(Some(&why));
    ran?;
    ended
}

fn sit(
    conduct: &mut Conduct,
    desk: Desk,
    how: &OnDesktop,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<String, Error> {
    let study = conduct.study().clone();
    let Desk { mut window, mut screen, wanted } = desk;
    let mut actor = match how.input {
        Input::Simulated(seed) => Some(Actor::new(&study, conduct.participant(), seed, true)?),
        _ => None,
    };
    let clock = HostClock::start();
    let (mut cursor, mut pressed, mut closed): (Option<Point>, bool, bool) = (None, false, false);
    let mut happened: Vec<(Timestamp, Option<Point>, bool)> = Vec::with_capacity(256);
    let mut seen: Option<(Option<Goal>, u8)> = None;
    // Behind the edge of a screen there is no way on: without it, edges and corners would be lines like any other.
    let wants_walls = study.geometry.is_unbounded() && actor.is_none();
    let mut has_walls = false;
    loop {
        happened.clear();
        let mut focus = None;
        let mut resized = None;
        window.wait(TICK, |event| match event {
            Event::PointerAt { x, y } => {
                cursor = Some(screen.task_from_pixel(x, y));
                happened.push((clock.now(), cursor, pressed));
            }
            Event::PointerLeft => cursor = None,
            Event::Button { button: PointerButton::Left, pressed: now } => {
                pressed = now;
                happened.push((clock.now(), cursor, pressed));
            }
            Event::Key { key, pressed: true, .. } if key == "Escape" => closed = true,
            Event::CloseRequested => closed = true,
            Event::Focused(has) => focus = Some(has),
            Event::Resized { width, height } => resized = Some((width, height)),
            _ => {}
        });
        if let Some(size) = resized {
            if size.0 < wanted.0 || size.1 < wanted.1 {
                return Err(too_small(wanted, size, how.dpi));
            }
            screen = Screen::new(&study, &window, how)?;
            seen = None;
        }
        match focus {
            Some(false) => {
                conduct.happened("headset", "the window lost the keyboard");
                if has_walls {
                    has_walls = !window.confine(false);
                }
            }
            Some(true) => conduct.happened("headset", "the window has the keyboard"),
            None => {}
        }
        if let Some(actor) = &mut actor {
            let now = clock.now();
            actor.see(now, &study, conduct.course().goal().as_ref())?;
            let (place, down) = actor.at(now);
            happened.clear();
            happened.push((now, Some(place.into()), down));
        } else if happened.is_empty() {
            happened.push((clock.now(), cursor, pressed));
        }
        for &(at, cursor, pressed) in &happened {
            if let Step::Trial(_) = conduct.follow(&Reading { at, cursor, pressed })? {
                let (done, all) = conduct.course().progress();
                progress(done, all);
                if !conduct.course().is_done() && conduct.is_enough(how.most_trials) {
                    return Ok(conduct.why_enough());
                }
            }
        }
        let course = conduct.course();
        let kind = match course.showing() {
            Showing::Instruction(_) => 0,
            Showing::Movement => 1,
            Showing::Break(_) => 2,
            Showing::Done => 3,
        };
        let now = (course.goal(), kind);
        if seen != Some(now) && screen.draw(course)? {
            seen = Some(now);
            if wants_walls && !has_walls {
                has_walls = window.confine(true);
            }
        }
        if course.is_done() {
            return Ok(String::new());
        }
        if closed {
            return Ok("the window was closed".to_owned());
        }
        if how.stop.is_stopped() {
            return Ok("asked to stop".to_owned());
        }
    }
}

fn too_small(wanted: (u32, u32), found: (u32, u32), dpi: f64) -> Error {
    Error::Call(format!(
        "at {dpi} pixels per inch this study takes a window of {}×{} pixels, found {}×{}: smaller amplitudes, a larger screen, \
         or --dpi, where the screen's is another",
        wanted.0, wanted.1, found.0, found.1
    ))
}

/// Draws the task to scale.
struct Screen {
    stimuli: Stimuli,
    view: View,
    renderer: Renderer,
    offscreen: Offscreen,
    mirror: gpu::Mirror,
    size: (u32, u32),
    pixels_per_m: f64,
    /// Depth of the task's plane in task coordinates, metres.
    plane_m: f64,
}

impl Screen {
    fn new(study: &Study, window: &Window, how: &OnDesktop) -> Result<Self, Error> {
        let (wanted, size) = (window_size(study, how)?, window.size());
        if size.0 < wanted.0 || size.1 < wanted.1 {
            return Err(too_small(wanted, size, how.dpi));
        }
        let pixels_per_m = how.dpi / INCH_M;
        let half = |pixels: u32| 0.5 * f64::from(pixels) / pixels_per_m;
        // Rays go out from the eye; otherwise the eye may be anywhere in front of the plane.
        let (eye_m, plane_m) = match study.geometry {
            Geometry::Ray { distance, .. } => (0.0, -distance),
            _ => (study.distance, 0.0),
        };
        let away = eye_m - plane_m;
        let (right, up) = ((half(size.0) / away).atan(), (half(size.1) / away).atan());
        let fov = Fov { left_rad: -right, right_rad: right, up_rad: up, down_rad: -up };
        let view = View { world_from_eye: Rigid::translation(0.0, 0.0, eye_m), fov };
        let words = Words { at: [0.0, half(size.1) - 0.6 * WORDS_M, plane_m], cap_height_m: 0.0035 };
        let stimuli = Stimuli::new(study, true, "Click", words);
        let desc = gpu::InstanceDesc { app_name: "vergence", validation: false, surface: window.display() };
        let instance = gpu::Instance::new(&desc, None)?;
        let device =
            gpu::Device::new(&instance, &gpu::DeviceDesc { present: true, ..Default::default() }, None)?;
        let quality =
            Quality { near_m: 0.01, cull_margin_m: 0.0, cull_margin_rad: 0.0, ..Quality::default() };
        let needs = Needs::of(stimuli.scene(), false);
        let picture = Picture::new(size, 1);
        let renderer = Renderer::new(&device, stimuli.scene(), &needs, &quality, &picture, 1)?;
        let offscreen = Offscreen::new(&device, &picture, false)?;
        let mirror = gpu::Mirror::new(&device, window.handle(), size)?;
        Ok(Self { stimuli, view, renderer, offscreen, mirror, size, pixels_per_m, plane_m })
    }

    /// Where a pixel is, seen from its upper left corner, in task coordinates.
    fn task_from_pixel(&self, x: f64, y: f64) -> Point {
        let from_middle = |at: f64, size: u32| (at + 0.5 - 0.5 * f64::from(size)) / self.pixels_per_m;
        [from_middle(x, self.size.0), -from_middle(y, self.size.1), self.plane_m]
    }

    /// Draws what there is to see; whether the window took it.
    fn draw(&mut self, course: &crate::Course) -> Result<bool, Error> {
        let Self { stimuli, view, renderer, offscreen, mirror, size, .. } = self;
        stimuli.show(course, &Rigid::identity(), None, None, |node, place| {
            renderer.show(node, place.is_some());
            if let Some(place) = place {
                renderer.place(node, place);
            }
        });
        let views = [*view];
        renderer.begin(0, Span::ZERO, &views, &offscreen.attachments())?;
        renderer.latch(0, &views)?;
        renderer.submit(0)?;
        Ok(offscreen.read(|pixels| mirror.present_pixels(&[pixels], *size))?? == gpu::Shown::Yes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vergence_study::TEMPLATE;

    fn on(input: Input) -> OnDesktop {
        OnDesktop { input, dpi: 96.0, most_trials: None, stop: Stop::default() }
    }

    #[test]
    fn windows_are_large_enough_and_some_tasks_need_a_headset() {
        let study = |from: &str, to: &str| Study::parse("t".as_ref(), &TEMPLATE.replace(from, to)).unwrap();
        let ring = study("", "");
        let (width, height) = window_size(&ring, &on(Input::Mouse)).unwrap();
        // 35 cm and 4 cm, with a margin, at 96 pixels per inch.
        assert!((1540..1560).contains(&width) && height > width, "{width} {height}");
        for (from, to, word) in [
            ("plane = \"xy\"", "plane = \"zx\"", "headset"),
            ("kind = \"ring\"", "kind = \"depth\"", "headset"),
        ] {
            let error = window_size(&study(from, to), &on(Input::Mouse)).unwrap_err();
            assert!(error.is_wrong_call() && error.to_string().contains(word), "{error}");
        }
        assert!(window_size(&ring, &on(Input::Gaze)).unwrap_err().to_string().contains("expected mouse"));
    }
}
