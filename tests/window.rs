//! A window on a screen of the test's own (Xvfb): what is mirrored is what the screen shows, and what the user does arrives.

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use vergence_gpu::{
    Device, DeviceDesc, Image, ImageDesc, Instance, InstanceDesc, Mirror, Shown, Upload, Use, vk,
};
use vergence_input::Config;
use vergence_sense::{Button, Reading, Sample, Sink, SourceStream, TouchPhase, Vector2};
use vergence_time::{Clock, HostClock, Span};
use vergence_window::{Event, PointerButton, Window};

/// Long enough for a busy machine; nothing here takes longer than a second on an idle one.
const PATIENCE: Duration = Duration::from_secs(30);
const SCREEN: &str = "640x480x24";
const TITLE: &str = "vergence window test";
const RED: [u8; 3] = [255, 0, 0];
const GREEN: [u8; 3] = [0, 255, 0];
const BLUE: [u8; 3] = [0, 0, 255];
const BLACK: [u8; 3] = [0, 0, 0];

/// A screen without hardware, with its content in a file.
struct Screen {
    server: Child,
    folder: tempfile::TempDir,
    display: String,
}

impl Screen {
    /// `None` where Xvfb is not installed.
    fn start() -> Option<Self> {
        let folder = tempfile::tempdir().expect("a folder");
        let mut server = Command::new("Xvfb")
            .args(["-displayfd", "1", "-screen", "0", SCREEN, "-nolisten", "tcp", "-fbdir"])
            .arg(folder.path())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .ok()?;
        let mut line = String::new();
        BufReader::new(server.stdout.take().expect("piped"))
            .read_line(&mut line)
            .expect("the display's number");
        Some(Self { server, folder, display: format!(":{}", line.trim()) })
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

/// The colour of one pixel of the screen, from the X window dump that the server keeps.
fn pixel(folder: &Path, x: usize, y: usize) -> [u8; 3] {
    let dump = std::fs::read(folder.join("Xvfb_screen0")).expect("the screen's file");
    let word = |i: usize| u32::from_be_bytes(dump[4 * i..4 * i + 4].try_into().expect("four bytes")) as usize;
    let (header, bits, line, colors) = (word(0), word(11), word(12), word(19));
    assert_eq!(bits, 32, "bits per pixel");
    let at = header + 12 * colors + y * line + 4 * x;
    [dump[at + 2], dump[at + 1], dump[at]]
}

/// Does something again and again until it is so.
fn until(what: &str, mut done: impl FnMut() -> bool) {
    let start = Instant::now();
    while !done() {
        assert!(start.elapsed() < PATIENCE, "waited in vain: {what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

fn xdotool(arguments: &[&str]) -> bool {
    Command::new("xdotool").args(arguments).status().is_ok_and(|status| status.success())
}

#[test]
fn a_window_shows_what_is_mirrored_and_tells_what_the_user_does() {
    on_a_screen("inner");
}

#[test]
fn the_desktop_is_a_source() {
    on_a_screen("inner_desktop");
}

/// Runs a test of this file on a screen of its own.
fn on_a_screen(test: &str) {
    let Some(screen) = Screen::start() else {
        vergence_tests::skip("xvfb", "no Xvfb");
        return;
    };
    // The display is named by an environment variable, which belongs to a process: the window gets one of its own.
    let output = Command::new(std::env::current_exe().expect("the test is a file"))
        .args(["--exact", test, "--ignored", "--nocapture"])
        .env("DISPLAY", &screen.display)
        .env("VERGENCE_TEST_SCREEN", screen.folder.path())
        .env_remove("WAYLAND_DISPLAY")
        .output()
        .expect("the test runs itself");
    let told =
        format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{told}");
    for line in told.lines().filter(|line| line.contains("skipped")) {
        eprintln!("{line}");
    }
}

#[test]
#[ignore = "run by the other test, on its screen"]
fn inner() {
    let folder = std::env::var_os("VERGENCE_TEST_SCREEN").expect("the other test's screen");
    let folder = Path::new(&folder);
    // The first window only shows that there can be a second one.
    drop(Window::open("first", (50, 50)).expect("a window"));
    let mut window = Window::open(TITLE, (400, 200)).expect("a second window");
    until("the window's size", || {
        window.poll(|_| ());
        window.size() == (400, 200)
    });
    mirrors(&mut window, folder);
    tells(&mut window);
}

fn two_pictures(device: &Arc<Device>) -> Arc<Image> {
    let texels = |color: [u8; 3]| [color[0], color[1], color[2], 255].repeat(100 * 100);
    let desc = ImageDesc {
        name: "two pictures",
        width: 100,
        height: 100,
        layers: 2,
        usage: vk::ImageUsageFlags::TRANSFER_SRC,
        ..Default::default()
    };
    let mut upload = Upload::new(device).expect("an uploader");
    upload.image(&desc, &[&texels(RED), &texels(GREEN)], false, Use::TransferSource).expect("an image")
}

fn mirrors(window: &mut Window, folder: &Path) {
    let display = window.display();
    assert!(display.is_some());
    let desc = InstanceDesc { app_name: TITLE, validation: true, surface: display };
    let device = Instance::new(&desc, None)
        .and_then(|i| Device::new(&i, &DeviceDesc { present: true, ..DeviceDesc::default() }, None));
    let device = match device {
        Ok(device) => device,
        Err(error) => return vergence_tests::skip("vulkan", &error.to_string()),
    };
    let image = two_pictures(&device);
    let handle = window.handle();
    let mut mirror = Mirror::new(&device, handle, window.size()).expect("a mirror");
    let show = |window: &mut Window, mirror: &mut Mirror, expected: &[(usize, usize, [u8; 3])]| {
        let mut shown = false;
        until("the pictures on the screen", || {
            window.poll(|event| {
                if let Event::Resized { width, height } = event {
                    mirror.resize((width, height));
                }
            });
            shown |= mirror.present(&image, 2, Use::TransferSource).expect("presented") == Shown::Yes;
            shown && expected.iter().all(|&(x, y, color)| pixel(folder, x, y) == color)
        });
    };
    // Squares of 200 side by side fill the window.
    show(window, &mut mirror, &[(10, 100, RED), (190, 100, RED), (210, 100, GREEN), (390, 100, GREEN)]);
    assert_eq!(mirror.size(), (400, 200));
    // A higher window has bars above and below.
    window.request_size((200, 300));
    show(window, &mut mirror, &[(50, 150, RED), (150, 150, GREEN), (50, 50, BLACK), (150, 250, BLACK)]);
    assert_eq!(mirror.size(), (200, 300));

    let pixels = [0, 0, 255, 255].repeat(20 * 30);
    until("the host's pixels on the screen", || {
        window.poll(|_| ());
        mirror.present_pixels(&[&pixels], (20, 30)).expect("presented");
        pixel(folder, 100, 150) == BLUE && pixel(folder, 100, 10) == BLUE
    });
    assert!(mirror.present_pixels(&[&pixels[1..]], (20, 30)).is_err(), "too few bytes");
    assert!(mirror.present(&image, 3, Use::TransferSource).is_err(), "more views than layers");
    assert_eq!(device.census().swapchains, 1);
    drop(mirror);
    assert_eq!(device.census().swapchains, 0);
    assert_eq!(device.validation_messages(), [""; 0]);
}

fn tells(window: &mut Window) {
    let mut events = Vec::new();
    if !xdotool(&["search", "--sync", "--name", TITLE, "windowfocus"]) {
        return vergence_tests::skip("xdotool", "no xdotool");
    }
    let mut collect = |window: &mut Window, what: &str, wanted: &dyn Fn(&Event) -> bool| {
        until(what, || {
            window.wait(Duration::from_millis(50), |event| events.push(event));
            events.iter().any(wanted)
        });
    };
    collect(window, "the focus", &|e| *e == Event::Focused(true));
    assert!(xdotool(&["mousemove", "30", "40", "click", "1", "key", "w"]));
    collect(window, "the pointer", &|e| *e == Event::PointerAt { x: 30.0, y: 40.0 });
    for pressed in [true, false] {
        collect(window, "the button", &|e| *e == Event::Button { button: PointerButton::Left, pressed });
        collect(window, "the key", &|e| *e == Event::Key { key: "KeyW".into(), pressed, repeated: false });
    }
    assert!(xdotool(&["mousemove_relative", "5", "7"]));
    collect(window, "the movement", &|e| *e == Event::PointerMoved { dx: 5.0, dy: 7.0 });
}

/// Readings of a desktop by the names of their streams.
#[derive(Default)]
struct Said(Vec<String>, Vec<(usize, Reading<'static>)>);

impl Sink for Said {
    fn appears(&mut self, _: usize, stream: &SourceStream) {
        self.0.push(stream.name.clone());
    }

    fn take(&mut self, stream: usize, sample: Sample<Reading<'_>>) {
        let mut one = Vec::new();
        Sink::take(&mut one, stream, sample);
        self.1.extend(one.into_iter().map(|(stream, sample)| (stream, sample.value)));
    }
}

#[test]
#[ignore = "run by the other test, on its screen"]
fn inner_desktop() {
    let clock: Arc<dyn Clock> = Arc::new(HostClock::start());
    let config = Config::default();
    let device = vergence_input::find("desktop", &config).expect("always there");
    let mut source = vergence_input::open(&device, &config, clock.clone()).expect("a window on this screen");
    let mut said = Said(source.streams().iter().map(|stream| stream.name.clone()).collect(), Vec::new());
    if !xdotool(&["search", "--sync", "--name", "Vergence: keys", "windowfocus"]) {
        return vergence_tests::skip("xdotool", "no xdotool");
    }
    let mut collect = |what: &str, name: &str, wanted: &dyn Fn(&Reading<'_>) -> bool| {
        until(what, || {
            source.advance(clock.now().saturating_add(Span::from_millis(50)), &mut said);
            said.1.iter().any(|(place, value)| said.0[*place] == name && wanted(value))
        });
    };
    let event =
        |name: &'static str| move |value: &Reading<'_>| matches!(value, Reading::Event(e) if e.name == name);
    let button = |is_down| move |value: &Reading<'_>| *value == Reading::Button(Button(Some(is_down)));
    collect("the window", "events", &event("connected"));
    collect("the focus", "events", &event("focused"));
    assert!(xdotool(&["mousemove", "30", "40", "click", "1", "key", "w", "click", "8"]));
    let phase = |phase| move |value: &Reading<'_>| matches!(value, Reading::Touch(touch) if touch.phase == phase && touch.position == [30.0, 40.0]);
    collect("the pointer", "pointer", &phase(TouchPhase::Hovers));
    for (is_down, touch) in [(true, TouchPhase::Begins), (false, TouchPhase::Ends)] {
        collect("the button", "mouse/left", &button(is_down));
        collect("the touch of the pointer", "pointer", &phase(touch));
        collect("the key", "key/w", &button(is_down));
    }
    assert!(xdotool(&["mousemove_relative", "5", "7"]));
    let moved = Reading::Vector2(Vector2(Some([5.0, -7.0])));
    collect("the movement", "mouse/move", &|value| *value == moved);
    assert!(!said.0.iter().any(|name| name == "mouse/back"), "only for who asks");
}
