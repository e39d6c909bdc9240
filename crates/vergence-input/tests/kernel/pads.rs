//! Pads and other things made with uinput.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, mpsc};
use std::time::Duration;

use evdev::uinput::VirtualDevice;
use evdev::{
    AbsInfo, AbsoluteAxisCode, AttributeSet, BusType, EventSummary, FFEffectCode, FFEffectKind, InputEvent,
    InputId, KeyCode, PropType, RelativeAxisCode, UInputCode, UinputAbsSetup,
};
use vergence_input::gamepad::Rumble;
use vergence_input::{Config, Error};
use vergence_sense::{Axis, Button, Reading, Vector2};
use vergence_time::Span;

use crate::{Clocked, Samples, found, has_event, of, open, read};

const KEY: u16 = 1;
const ABS: u16 = 3;

/// Buttons as the driver xpad has them, and where they are on the pad.
const BUTTONS: [(u16, &str); 11] = [
    (0x130, "south"),
    (0x131, "east"),
    (0x133, "west"),
    (0x134, "north"),
    (0x136, "left_shoulder"),
    (0x137, "right_shoulder"),
    (0x13a, "select"),
    (0x13b, "start"),
    (0x13c, "guide"),
    (0x13d, "left_stick/click"),
    (0x13e, "right_stick/click"),
];

fn axis(code: u16, low: i32, high: i32) -> UinputAbsSetup {
    UinputAbsSetup::new(AbsoluteAxisCode(code), AbsInfo::new(0, low, high, 0, 0, 0))
}

/// A wired Xbox 360 pad, as its driver describes it.
///
/// Its motors are such that gilrs leaves them alone, which asks for more than rumble: nobody answers here.
pub(crate) fn xbox() -> VirtualDevice {
    with_effects(&[FFEffectCode::FF_RUMBLE])
}

/// The same with every effect that the kernel adds to those of simple motors.
fn xbox_with_motors() -> VirtualDevice {
    with_effects(&[
        FFEffectCode::FF_RUMBLE,
        FFEffectCode::FF_PERIODIC,
        FFEffectCode::FF_SQUARE,
        FFEffectCode::FF_TRIANGLE,
        FFEffectCode::FF_SINE,
        FFEffectCode::FF_GAIN,
    ])
}

fn with_effects(effects: &[FFEffectCode]) -> VirtualDevice {
    let keys: AttributeSet<KeyCode> = BUTTONS.iter().map(|(code, _)| KeyCode(*code)).collect();
    let mut builder = VirtualDevice::builder()
        .and_then(|builder| {
            builder
                .name("Microsoft X-Box 360 pad")
                .input_id(InputId::new(BusType::BUS_USB, 0x045e, 0x028e, 0x0114))
                .with_keys(&keys)
        })
        .expect("uinput");
    for (code, low, high) in [
        (0, -32768, 32767),
        (1, -32768, 32767),
        (2, 0, 255),
        (3, -32768, 32767),
        (4, -32768, 32767),
        (5, 0, 255),
        (0x10, -1, 1),
        (0x11, -1, 1),
    ] {
        builder = builder.with_absolute_axis(&axis(code, low, high)).expect("an axis");
    }
    let motors: AttributeSet<FFEffectCode> = effects.iter().copied().collect();
    builder.with_ff(&motors).expect("motors").with_ff_effects_max(16).build().expect("a pad")
}

fn send(pad: &mut VirtualDevice, kind: u16, code: u16, value: i32) {
    pad.emit(&[InputEvent::new(kind, code, value)]).expect("sent");
}

fn wait_connected(pad: &mut Clocked) -> Samples {
    read(pad, |samples| has_event(samples, "connected") && samples.len() > 10)
}

/// What comes of `name` after a change of the pad.
fn after(
    source: &mut Clocked,
    pad: &mut VirtualDevice,
    kind: u16,
    code: u16,
    value: i32,
    name: &str,
) -> Reading<'static> {
    send(pad, kind, code, value);
    let samples = read(source, |samples| !samples.is_empty());
    assert_eq!(samples.len(), 1, "one change, one sample: {samples:?}");
    let sample = &samples[0].1;
    // The kernel had it before the thread that reads did.
    assert!(sample.captured < sample.arrived, "{sample:?}");
    of(source, &samples, name)
        .first()
        .map(|reading| (*reading).clone())
        .unwrap_or_else(|| panic!("{name}: {samples:?}"))
}

pub(crate) fn every_button_and_axis() {
    let mut pad = xbox();
    let devices = found("gamepad", 1);
    assert_eq!((devices[0].vendor_id, devices[0].product_id), (Some(0x045e), Some(0x028e)));
    assert_eq!(devices[0].problem, None);
    let mut source = open(&devices[0], &Config::default());
    let first = wait_connected(&mut source);
    assert_eq!(of(&source, &first, "left_stick"), [&Reading::Vector2(Vector2(Some([0.0, 0.0])))]);
    assert_eq!(of(&source, &first, "south"), [&Reading::Button(Button(Some(false)))]);
    assert_eq!(source.source.streams().len(), 1 + 2 + 2 + 15, "events, sticks, triggers, buttons");
    for (code, name) in BUTTONS {
        for down in [true, false] {
            let said = after(&mut source, &mut pad, KEY, code, i32::from(down), name);
            assert_eq!(said, Reading::Button(Button(Some(down))), "{name}");
        }
    }
    for (code, low, high) in [(0x10, "dpad/left", "dpad/right"), (0x11, "dpad/up", "dpad/down")] {
        for (value, name) in [(-1, low), (1, high)] {
            assert_eq!(
                after(&mut source, &mut pad, ABS, code, value, name),
                Reading::Button(Button(Some(true)))
            );
            assert_eq!(
                after(&mut source, &mut pad, ABS, code, 0, name),
                Reading::Button(Button(Some(false)))
            );
        }
    }
    let mut stick = |code, value, name: &str| {
        let Reading::Vector2(Vector2(Some(at))) = after(&mut source, &mut pad, ABS, code, value, name) else {
            panic!("{name} is a stick")
        };
        at
    };
    assert_eq!(stick(0, 32767, "left_stick"), [1.0, 0.0]);
    assert_eq!(stick(1, -32768, "left_stick"), [1.0, 1.0], "away is up");
    assert_eq!(stick(3, -32768, "right_stick"), [-1.0, 0.0]);
    assert_eq!(stick(4, 32767, "right_stick"), [-1.0, -1.0]);
    assert_eq!(stick(0, -1, "left_stick"), [0.0, 1.0], "half a step beside the middle is the middle");
    for (code, name) in [(2, "left_trigger"), (5, "right_trigger")] {
        assert_eq!(after(&mut source, &mut pad, ABS, code, 255, name), Reading::Axis(Axis(Some(1.0))));
        assert_eq!(after(&mut source, &mut pad, ABS, code, 0, name), Reading::Axis(Axis(Some(0.0))));
    }
}

pub(crate) fn others_are_no_gamepads() {
    let build = |name: &str, keys: &[u16], axes: &[(u16, i32)], property: PropType| {
        let keys: AttributeSet<KeyCode> = keys.iter().copied().map(KeyCode).collect();
        let properties: AttributeSet<PropType> = [property].into_iter().collect();
        let mut builder = VirtualDevice::builder()
            .and_then(|b| {
                b.name(name).input_id(InputId::new(BusType::BUS_USB, 0x056a, 1, 1)).with_keys(&keys)
            })
            .and_then(|b| b.with_properties(&properties))
            .expect("uinput");
        for (code, high) in axes {
            builder = builder.with_absolute_axis(&axis(*code, 0, *high)).expect("an axis");
        }
        builder.build().expect("a device")
    };
    let others = [
        build(
            "tablet",
            &[0x140, 0x14a, 0x14b, 0x14c],
            &[(0, 20000), (1, 20000), (0x18, 2047)],
            PropType::DIRECT,
        ),
        build("touchpad", &[0x110, 0x145, 0x14a], &[(0, 1920), (1, 1080), (0x2f, 1)], PropType::POINTER),
        build("pad of a tablet", &[0x100, 0x101, 0x14b], &[(0, 1), (1, 1)], PropType::DIRECT),
        build("keyboard", &(1..120).collect::<Vec<_>>(), &[], PropType::POINTER),
    ];
    let moves: AttributeSet<RelativeAxisCode> =
        [RelativeAxisCode::REL_X, RelativeAxisCode::REL_Y].into_iter().collect();
    let keys: AttributeSet<KeyCode> = [KeyCode::BTN_LEFT, KeyCode::BTN_RIGHT].into_iter().collect();
    let mouse = VirtualDevice::builder()
        .and_then(|b| b.name("mouse").with_keys(&keys))
        .and_then(|b| b.with_relative_axes(&moves))
        .and_then(evdev::uinput::VirtualDeviceBuilder::build)
        .expect("a mouse");
    let pad = xbox();
    // Once the pad, which was plugged in last, is there, the others are.
    assert_eq!(found("gamepad", 1)[0].name, "Microsoft X-Box 360 pad");
    drop((others, mouse, pad));
    found("gamepad", 0);
}

pub(crate) fn two_between_two_looks() {
    assert_eq!(vergence_input::found(&Config::default()), []);
    let (mut first, mut second) = (xbox(), xbox());
    let devices = found("gamepad", 2);
    let [mut one, mut two] = [0, 1].map(|index| open(&devices[index], &Config::default()));
    wait_connected(&mut one);
    wait_connected(&mut two);
    // Which node is which pad's is the kernel's choice.
    send(&mut first, KEY, 0x130, 1);
    send(&mut second, KEY, 0x131, 1);
    let (of_one, of_two) =
        (read(&mut one, |samples| !samples.is_empty()), read(&mut two, |samples| !samples.is_empty()));
    let pressed = |source: &Clocked, samples: &Samples| {
        ["south", "east"]
            .map(|name| of(source, samples, name).contains(&&Reading::Button(Button(Some(true)))))
    };
    let both = [pressed(&one, &of_one), pressed(&two, &of_two)];
    assert!(both == [[true, false], [false, true]] || both == [[false, true], [true, false]], "{both:?}");
    // The loss of one does not make its reader take the other, which is of the same kind.
    let (mut lost, kept) = if both[0][0] { (one, two) } else { (two, one) };
    let kept_path = devices[usize::from(both[0][0])].path.clone();
    drop(first);
    let samples = read(&mut lost, |samples| has_event(samples, "disconnected"));
    assert!(!has_event(&samples, "connected"));
    let until = lost.clock.now().saturating_add(Span::from_millis(1500));
    let mut rest = Samples::new();
    while lost.clock.now() < until {
        lost.source.advance(until, &mut rest);
    }
    assert!(!has_event(&rest, "connected"), "{rest:?}");
    drop(lost);
    // Two more at once, while gilrs runs for the one that stayed: each is read.
    let more = [xbox(), xbox()];
    for device in found("gamepad", 3).iter().filter(|device| device.path != kept_path) {
        wait_connected(&mut open(device, &Config::default()));
    }
    drop((kept, more, second));
    found("gamepad", 0);
}

pub(crate) fn goes_and_comes_back() {
    let mut pad = xbox();
    let mut source = open(&found("gamepad", 1)[0], &Config::default());
    wait_connected(&mut source);
    send(&mut pad, KEY, 0x130, 1);
    read(&mut source, |samples| !samples.is_empty());
    for _ in 0..3 {
        let (unplug, unplugged) = mpsc::channel();
        let thread = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(100));
            drop(pad);
            unplug.send(()).expect("somebody waits");
        });
        let samples = read(&mut source, |samples| has_event(samples, "disconnected"));
        assert_eq!(
            of(&source, &samples, "south").last(),
            Some(&&Reading::Button(Button(None))),
            "offers nothing"
        );
        unplugged.recv().expect("unplugged");
        thread.join().expect("no panic");
        found("gamepad", 0);
        pad = xbox();
        let samples = wait_connected(&mut source);
        assert_eq!(
            of(&source, &samples, "south").last(),
            Some(&&Reading::Button(Button(Some(false)))),
            "let go"
        );
        assert_eq!(after(&mut source, &mut pad, KEY, 0x131, 1, "east"), Reading::Button(Button(Some(true))));
    }
    // A burst of more than the kernel keeps: the last state counts.
    for step in 0..4000 {
        send(&mut pad, ABS, 0, step);
    }
    send(&mut pad, ABS, 0, 32767);
    read(&mut source, |samples| {
        samples.iter().any(|(_, s)| matches!(s.value, Reading::Vector2(Vector2(Some([x, _]))) if x == 1.0))
    });
}

/// Magnitudes of an effect that is loaded, or that one is played.
type Told = Option<(u16, u16)>;

/// A pad whose motors are answered for. It vanishes when it is dropped, also where a scene fails.
struct Answered {
    over: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Drop for Answered {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(std::thread::JoinHandle::join);
    }
}

fn answered() -> (mpsc::Receiver<Told>, Answered) {
    let mut pad = xbox_with_motors();
    let over = Arc::new(AtomicBool::new(false));
    let (told, heard) = mpsc::channel();
    let ends = over.clone();
    let nonblocking = rustix::fs::OFlags::NONBLOCK;
    rustix::fs::fcntl_setfl(&pad, nonblocking).expect("a file");
    // The kernel asks the pad before the effect's upload returns.
    let thread = std::thread::spawn(move || {
        while !ends.load(Ordering::Relaxed) {
            let events: Vec<InputEvent> = match pad.fetch_events() {
                Ok(events) => events.collect(),
                Err(error) => {
                    assert_eq!(error.kind(), std::io::ErrorKind::WouldBlock);
                    std::thread::sleep(Duration::from_millis(2));
                    continue;
                }
            };
            for event in events {
                match event.destructure() {
                    EventSummary::UInput(event, UInputCode::UI_FF_UPLOAD, _) => {
                        let mut upload = pad.process_ff_upload(event).expect("an upload");
                        upload.set_retval(0);
                        if let FFEffectKind::Rumble { strong_magnitude, weak_magnitude } =
                            upload.effect().kind
                        {
                            let _ = told.send(Some((strong_magnitude, weak_magnitude)));
                        }
                    }
                    EventSummary::UInput(event, UInputCode::UI_FF_ERASE, _) => {
                        pad.process_ff_erase(event).expect("an erasure").set_retval(0);
                    }
                    EventSummary::ForceFeedback(_, _, 1) => {
                        let _ = told.send(None);
                    }
                    _ => {}
                }
            }
        }
    });
    (heard, Answered { over, thread: Some(thread) })
}

/// Waits until these magnitudes are loaded and played; gilrs loads and plays all the time.
fn wait_played(heard: &mpsc::Receiver<Told>, strong: u16, weak: u16) {
    let mut is_loaded = false;
    loop {
        match heard.recv_timeout(crate::PATIENCE).expect("the pad is told") {
            Some(magnitudes) => is_loaded = magnitudes == (strong, weak),
            None if is_loaded => return,
            None => {}
        }
    }
}

pub(crate) fn rumble() {
    let quiet = xbox();
    let device = found("gamepad", 1).remove(0);
    assert!(matches!(Rumble::open(&device), Err(Error::Open { .. })), "none that gilrs knows");
    drop(quiet);
    found("gamepad", 0);
    let (heard, pad) = answered();
    let device = found("gamepad", 1).remove(0);
    let mut motors = Rumble::open(&device).expect("a pad with motors");
    motors.play(1.0, 0.5, Span::from_millis(200)).expect("played");
    wait_played(&heard, 65535, 32768);
    wait_played(&heard, 0, 0);
    motors.play(0.25, 0.0, Span::from_millis(30_000)).expect("played");
    wait_played(&heard, 16384, 0);
    motors.stop().expect("stopped");
    wait_played(&heard, 0, 0);
    motors.play(0.5, 0.5, Span::from_millis(30_000)).expect("played");
    wait_played(&heard, 32768, 32768);
    drop(motors);
    wait_played(&heard, 0, 0);
    // One that vanishes while it is held.
    let mut held = Rumble::open(&device).expect("a pad with motors");
    drop(pad);
    assert!(matches!(held.play(1.0, 1.0, Span::from_millis(10)), Err(Error::Gone { .. })));
    found("gamepad", 0);
    assert!(matches!(Rumble::open(&device), Err(Error::Gone { .. })), "it vanished");
}
