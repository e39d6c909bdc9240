//! Bindings as people write, change and break them, and what actions then are.

use std::path::Path;

use proptest::prelude::*;
use vergence_action::{Bindings, Mapper, Reading, Value};
use vergence_sense::Pose;
use vergence_time::Timestamp;

const EXAMPLE: &str = r#"
layout = "playstation"

[actions.jump]
label = "Jump"
kind = "button"
bind = [{ input = "pad.south" }, { input = "key.space" }]

[actions.dash]
kind = "button"
bind = [{ input = "key.space", with = ["key.left_shift"] }]

[actions.pull]
kind = "button"
bind = [{ input = "pad.right_trigger", press_at = 0.6, release_at = 0.4 }]

[actions.steer]
kind = "valuator"
bind = [
    { input = "pad.left_stick.x", dead_zone = { shape = "axial", inner = 0.1, outer = 0.9, hysteresis = 0.02 }, curve = "power 2" },
    { negative = "key.a", positive = "key.d" },
]

[actions.move]
kind = "locator"
set = "walk"
bind = [
    { input = "pad.left_stick", dead_zone = { inner = 0.15 }, filter = { kind = "one-euro", least_cutoff = "2 Hz", beta = 5.0 } },
    { left = "key.left", right = "key.right", up = "key.up", down = "key.down" },
]

[actions.tool]
kind = "choice"
options = ["ray", "hand", "lasso"]
bind = [{ input = "pad.right_shoulder", step = 1 }, { input = "pad.left_shoulder", step = -1 }, { input = "key.2", option = "hand" }]

[actions.aim]
kind = "pose"
bind = [{ input = "hand.right.aim" }, { input = "gaze" }]

[actions.target]
kind = "pick"
bind = [{ input = "hit" }]

[actions.name]
kind = "string"
bind = [{ input = "text" }]
"#;

fn parse(text: &str) -> Result<Bindings, String> {
    Bindings::parse(Path::new("b.toml"), text).map_err(|error| error.to_string())
}

struct Hands {
    mapper: Mapper,
    now_ns: i64,
}

impl Hands {
    fn new(text: &str) -> Self {
        Self { mapper: Mapper::new(&parse(text).expect("good bindings")).expect("good knobs"), now_ns: 0 }
    }

    /// The actions that changed, by name.
    fn feed(&mut self, input: &str, reading: Reading<'_>) -> usize {
        self.now_ns += 10_000_000;
        let input = self.mapper.input(input).expect("a watched input");
        self.mapper.feed(Timestamp::from_nanos(self.now_ns), input, reading).len()
    }

    fn value(&self, action: &str) -> Value {
        let action = self.mapper.action(action).expect("an action");
        self.mapper.value(action).expect("every action has a value").clone()
    }
}

#[test]
fn every_logical_device_says_what_its_inputs_say() {
    let mut hands = Hands::new(EXAMPLE);
    assert_eq!(hands.feed("pad.south", Reading::Button(true)), 1);
    assert_eq!(hands.value("jump"), Value::Button(true));
    // The other binding too: nothing changes until both are up.
    assert_eq!(hands.feed("key.space", Reading::Button(true)), 0);
    hands.feed("pad.south", Reading::Button(false));
    assert_eq!(hands.value("jump"), Value::Button(true));
    hands.feed("key.space", Reading::Button(false));
    assert_eq!(hands.value("jump"), Value::Button(false));

    for (pulled, is_down) in [(0.59, false), (0.6, true), (0.45, true), (0.39, false), (0.5, false)] {
        hands.feed("pad.right_trigger", Reading::Axis(pulled));
        assert_eq!(hands.value("pull"), Value::Button(is_down), "{pulled}");
    }

    hands.feed("pad.left_stick", Reading::Vector([0.5, 0.0]));
    let Value::Valuator(half) = hands.value("steer") else { panic!() };
    assert!((half - 0.25).abs() < 0.02, "{half}");
    hands.feed("key.a", Reading::Button(true));
    assert_eq!(hands.value("steer"), Value::Valuator(-1.0));
    hands.feed("key.a", Reading::Button(false));
    hands.feed("pad.left_stick", Reading::Vector([0.05, 0.05]));
    assert_eq!(hands.value("steer"), Value::Valuator(0.0));

    hands.feed("key.up", Reading::Button(true));
    hands.feed("key.left", Reading::Button(true));
    assert_eq!(hands.value("move"), Value::Locator([-1.0, 1.0]));
    hands.mapper.activate("walk", false);
    assert_eq!(hands.value("move"), Value::Locator([0.0; 2]));
    hands.mapper.activate("walk", true);
    assert_eq!(hands.value("move"), Value::Locator([-1.0, 1.0]));

    for (input, place) in [("pad.left_shoulder", 2), ("pad.right_shoulder", 0), ("key.2", 1)] {
        hands.feed(input, Reading::Button(true));
        hands.feed(input, Reading::Button(false));
        assert_eq!(hands.value("tool"), Value::Choice(place), "{input}");
    }

    let pose = Pose::from_parts(
        [1.0, 2.0, 3.0],
        vergence_sense::Tracking::Measured,
        [0.0, 0.0, 0.0, 1.0],
        vergence_sense::Tracking::Measured,
    );
    hands.feed("gaze", Reading::Pose(pose));
    assert_eq!(hands.value("aim"), Value::Pose(pose));
    hands.feed("hit", Reading::Pick(Some(7)));
    assert_eq!(hands.value("target"), Value::Pick(Some(7)));
    assert_eq!((hands.feed("text", Reading::Text("né")), hands.feed("text", Reading::Text("né"))), (1, 1));
    assert_eq!(hands.value("name"), Value::String("né".to_owned()));
    hands.feed("gaze", Reading::Gone);
    assert_eq!(hands.value("aim"), Value::Pose(Pose::LOST));
}

const MOVES: &str = r#"
[actions.walk]
kind = "locator"
bind = [{ left = "pad.dpad.left", right = "pad.dpad.right", up = "pad.dpad.up", down = "pad.dpad.down" }]

[actions.look]
kind = "locator"
bind = [{ input = "pad.right_stick", dead_zone = { inner = 0.15 }, filter = { kind = "low-pass", cutoff = "2 Hz" } }]

[actions.steer]
kind = "valuator"
bind = [{ input = "pad.left_stick.x", filter = { kind = "one-euro", least_cutoff = "2 Hz", beta = 5.0 } }]
"#;

/// Pads say all that has changed in one report, with one time.
#[test]
fn what_changes_at_once_all_counts() {
    let mut mapper = Mapper::new(&parse(MOVES).unwrap()).unwrap();
    let input = |mapper: &Mapper, name: &str| mapper.input(name).unwrap();
    let walk = mapper.action("walk").unwrap();
    let ways = ["left", "right", "up", "down"].map(|way| input(&mapper, &format!("pad.dpad.{way}")));
    let at = Timestamp::from_nanos;
    mapper.feed(at(10), ways[0], Reading::Button(true));
    mapper.feed(at(20), ways[2], Reading::Button(true));
    assert_eq!(mapper.value(walk), Some(&Value::Locator([-1.0, 1.0])));
    mapper.feed(at(30), ways[0], Reading::Button(false));
    mapper.feed(at(30), ways[2], Reading::Button(false));
    assert_eq!(mapper.value(walk), Some(&Value::Locator([0.0, 0.0])), "a diagonal is let go in one report");
    mapper.feed(at(40), ways[1], Reading::Button(true));
    // A pad that is gone, and what another device said a moment before.
    for way in ways {
        mapper.feed(at(35), way, Reading::Gone);
    }
    assert_eq!(mapper.value(walk), Some(&Value::Locator([0.0, 0.0])), "the pad is gone");
    // The last of what a filter is told at once holds, too, and is smoothed from what was before.
    let (look, stick) = (mapper.action("look").unwrap(), input(&mapper, "pad.right_stick"));
    let mut twice = mapper.clone();
    for mapper in [&mut mapper, &mut twice] {
        mapper.feed(at(1_000_000_000), stick, Reading::Vector([0.5, 0.0]));
    }
    twice.feed(at(1_010_000_000), stick, Reading::Vector([-1.0, 1.0]));
    for mapper in [&mut mapper, &mut twice] {
        mapper.feed(at(1_010_000_000), stick, Reading::Vector([1.0, 0.0]));
    }
    assert_eq!(mapper.value(look), twice.value(look));
}

/// Pads say changes only: after the last one nothing comes that could bring a filter to rest.
#[test]
fn nothing_creeps_after_a_stick_is_let_go_and_what_is_held_is_reached() {
    for (input, action) in [("pad.right_stick", "look"), ("pad.left_stick", "steer")] {
        for last in [Reading::Vector([0.0, 0.0]), Reading::Gone] {
            let mut hands = Hands::new(MOVES);
            let first = |value: Value| match value {
                Value::Locator([x, _]) | Value::Valuator(x) => x,
                value => panic!("{value:?}"),
            };
            for _ in 0..80 {
                hands.feed(input, Reading::Vector([1.0, 0.0]));
            }
            hands.feed(input, Reading::Vector([0.5, 0.0]));
            let held = |now_ns: i64| Timestamp::from_nanos(now_ns);
            let stopped = first(hands.value(action));
            // Held still: time alone brings it there.
            for frame in 0..200 {
                hands.mapper.advance(held(hands.now_ns + frame * 11_000_000));
            }
            hands.now_ns += 2_200_000_000;
            let there = first(hands.value(action));
            let wanted = if action == "look" { (0.5 - 0.15) / (0.95 - 0.15) } else { 0.5 };
            assert!(
                stopped > wanted + 0.1 && (there - wanted).abs() < 1e-3,
                "{action}: {stopped}, then {there}"
            );
            assert!(hands.mapper.advance(held(hands.now_ns + 60_000_000_000)).len() <= 1);
            hands.feed(input, last);
            assert_eq!(first(hands.value(action)), 0.0, "{action} after {last:?}");
            assert_eq!(hands.mapper.advance(held(hands.now_ns + 1)), []);
        }
    }
}

#[test]
fn a_chord_hides_its_plain_input_and_a_release_presses_nothing() {
    let mut hands = Hands::new(EXAMPLE);
    hands.feed("key.left_shift", Reading::Button(true));
    hands.feed("key.space", Reading::Button(true));
    assert_eq!((hands.value("dash"), hands.value("jump")), (Value::Button(true), Value::Button(false)));
    hands.feed("key.left_shift", Reading::Button(false));
    assert_eq!((hands.value("dash"), hands.value("jump")), (Value::Button(false), Value::Button(false)));
    // Held before the chord: it stays what it was.
    hands.feed("key.space", Reading::Button(false));
    hands.feed("key.space", Reading::Button(true));
    hands.feed("key.left_shift", Reading::Button(true));
    assert_eq!((hands.value("dash"), hands.value("jump")), (Value::Button(false), Value::Button(true)));
}

#[test]
fn bindings_change_while_it_runs_and_conflicts_are_said() {
    let mut bindings = parse(EXAMPLE).unwrap();
    assert_eq!(bindings.conflicts(), []);
    let conflicts = bindings.rebind("jump", 0, "pad.right_shoulder", &[]).unwrap();
    assert_eq!(conflicts.len(), 1);
    assert_eq!(conflicts[0].to_string(), "pad.right_shoulder does both \"jump\" and \"tool\"");
    assert_eq!(bindings.rebind("jump", 0, "pad.north", &[]).unwrap(), []);
    // A component and its whole, in one set.
    let text = "[actions.a]\nkind='locator'\nbind=[{input='pad.left_stick'}]\n[actions.b]\nkind='valuator'\nbind=[{input='pad.left_stick.x'}]\n";
    assert_eq!(parse(text).unwrap().conflicts()[0].input, "pad.left_stick.x");

    let mut hands = Hands::new(EXAMPLE);
    hands.feed("pad.right_shoulder", Reading::Button(true));
    hands.feed("pad.south", Reading::Button(true));
    hands.mapper.replace(&bindings).unwrap();
    // What is down does nothing new; the choice is kept.
    assert_eq!((hands.value("jump"), hands.value("tool")), (Value::Button(false), Value::Choice(1)));
    assert_eq!(hands.mapper.input("pad.south"), None);
    hands.feed("pad.north", Reading::Button(true));
    assert_eq!(hands.value("jump"), Value::Button(true));

    let before = bindings.clone();
    assert!(bindings.rebind("jump", 0, "pad.left_stick.w", &[]).is_err());
    assert!(bindings.rebind("jump", 9, "key.a", &[]).is_err());
    assert!(bindings.rebind("fly", 0, "key.a", &[]).is_err());
    assert!(bindings.rebind("aim", 0, "key.a", &[]).is_err());
    assert_eq!(bindings, before);
    bindings.unbind("jump", 1).unwrap();
    let written = bindings.to_toml().unwrap();
    assert_eq!(parse(&written).unwrap().actions(), bindings.actions(), "{written}");
}

#[test]
fn extra_mouse_buttons_are_for_who_asks() {
    let text = "[actions.a]\nkind = 'button'\nbind = [{ input = 'mouse.back' }]\n";
    assert!(parse(text).unwrap_err().contains("expected extra_mouse_buttons = true"));
    assert!(parse(&format!("extra_mouse_buttons = true\n{text}")).is_ok());
}

#[test]
fn faults_have_file_line_and_column() {
    for (text, expected) in [
        (
            "[actions.a]\nkind = 'button'\nbind = [\n  { input = 'pad.souht' },\n]\n",
            "b.toml:4:3: a: expected an input such as \"pad.south\"",
        ),
        ("[actions.a]\nkind = 'knob'\n", "b.toml:2:8: unknown variant `knob`"),
        (
            "[actions.a]\nkind = 'pose'\nbind = [{ input = 'key.a' }]\n",
            "b.toml:3:9: a: expected an input for a pose, found key.a",
        ),
        (
            "[actions.a]\nkind = 'valuator'\nbind = [{ negative = 'key.a' }]\n",
            "b.toml:3:9: a: expected either input, or negative and positive",
        ),
        (
            "[actions.a]\nkind = 'choice'\nbind = [{ input = 'key.a', step = 1 }]\n",
            "b.toml:3:9: a: expected options for a choice",
        ),
        (
            "[actions.a]\nkind = 'button'\nbind = [{ input = 'key.a', filter = { kind = 'low-pass', beta = 1.0 } }]\n",
            "b.toml:3:9: a: filter: expected knobs of \"low-pass\", found beta",
        ),
        (
            "[actions.a]\nkind = 'valuator'\nbind = [{ input = 'key.a', filter = { kind = 'low-pass', cutoff = '5 s' } }]\n",
            "b.toml:3:9: a: expected a frequency",
        ),
        (
            "[actions.a]\nkind = 'valuator'\nbind = [{ input = 'key.a', dead_zone = { inner = 2.0 } }]\n",
            "b.toml:3:9: a: dead zone: expected",
        ),
        ("[actions.a]\nkind = 'button'\nbimd = []\n", "b.toml:3:1: unknown field `bimd`"),
    ] {
        let found = parse(text).unwrap_err();
        assert!(found.starts_with(expected), "{found}\n{expected}");
    }
}

/// Of this thread, seconds: a machine that is busy with something else tests nothing.
fn processor_secs() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// As many cases as fit into `VERGENCE_FUZZ_S` seconds of processor time (2 where it is not set).
fn fuzz(name: &str, mut case: impl FnMut(u64)) {
    let secs: f64 = std::env::var("VERGENCE_FUZZ_S").ok().and_then(|text| text.parse().ok()).unwrap_or(2.0);
    let begin = processor_secs();
    let mut count = 0u64;
    while processor_secs() - begin < secs {
        for _ in 0..64 {
            case(count);
            count += 1;
        }
    }
    println!("{name}: {count} cases in {secs} s of processor time");
}

/// SplitMix64's finaliser: a dice of its own, as tests may use no other room's.
fn luck(seed: u64, index: u64) -> u64 {
    let mut z =
        seed.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(index.wrapping_mul(0xd6e8_feb8_6659_fd93));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// What is damaged: bytes turned, stretches cut, doubled, or put elsewhere, words of the format strewn in.
fn damaged(text: &str, seed: u64) -> String {
    const WORDS: [&str; 16] = [
        "[actions.a]\n",
        "bind = [",
        "{ input = \"pad.left_stick.x\" }",
        "]",
        "}",
        "with = [\"key.a\"]",
        "nan",
        "1e308",
        "-",
        "scale = inf",
        "curve = \"points 0.5:nan\"",
        "kind = \"choice\"",
        "options = []",
        "\"\\u0000\"",
        "dead_zone = {}",
        "filter = { kind = \"one-euro\" }",
    ];
    let mut bytes = text.as_bytes().to_vec();
    for round in 0..1 + luck(seed, 0) % 8 {
        let dice = |k: u64| luck(seed, 16 * round + k + 1) as usize;
        let (a, b) = (dice(0) % (bytes.len() + 1), dice(1) % (bytes.len() + 1));
        let (low, high) = (a.min(b), a.max(b).min(a.min(b) + 200));
        match dice(2) % 5 {
            0 if low < bytes.len() => bytes[low] ^= 1 << (dice(3) % 8),
            1 => drop(bytes.drain(low..high)),
            2 => {
                let piece = bytes[low..high].to_vec();
                let place = dice(3) % (bytes.len() + 1);
                bytes.splice(place..place, piece);
            }
            3 => {
                let word = WORDS[dice(3) % WORDS.len()];
                bytes.splice(low..low, word.bytes());
            }
            _ => bytes.truncate(bytes.len() - (dice(3) % 40).min(bytes.len())),
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

#[test]
fn fuzz_bindings() {
    let mut read = 0u64;
    fuzz("bindings", |seed| {
        let Ok(bindings) = parse(&damaged(EXAMPLE, seed)) else { return };
        read += 1;
        let _ = bindings.conflicts();
        // What is read can be written and read again, and works.
        let written = bindings.to_toml().unwrap();
        assert_eq!(parse(&written).unwrap().actions(), bindings.actions(), "{written}");
        exercise(&bindings, seed);
    });
    assert!(read > 0, "not one of the damaged files was read: the rest tested nothing");
}

fn exercise(bindings: &Bindings, seed: u64) {
    let mut mapper = Mapper::new(bindings).expect("knobs were checked");
    let inputs: Vec<_> = mapper.inputs().map(|(input, _)| input).collect();
    if inputs.is_empty() {
        return;
    }
    for k in 0..40 {
        let dice = luck(seed, 1000 + k);
        let number = f64::from_bits(luck(seed, 2000 + k));
        let reading = match dice % 8 {
            0 | 1 => Reading::Button(dice & 256 != 0),
            2 => Reading::Axis(number),
            3 => Reading::Vector([number, (dice % 1000) as f64 / 500.0 - 1.0]),
            4 => Reading::Pose(Pose::LOST),
            5 => Reading::Pick(Some(dice)),
            6 => Reading::Text("é"),
            _ => Reading::Gone,
        };
        let at = Timestamp::from_nanos((dice >> 8) as i64);
        let changed = mapper.feed(at, inputs[(dice >> 16) as usize % inputs.len()], reading).to_vec();
        for action in changed {
            match mapper.value(action).expect("it changed") {
                Value::Valuator(x) => assert!(x.is_finite()),
                Value::Locator(v) => assert!(v.iter().all(|x| x.is_finite())),
                _ => {}
            }
        }
    }
}

#[test]
fn fuzz_mappings() {
    let bindings = parse(EXAMPLE).unwrap();
    fuzz("mappings", |seed| exercise(&bindings, seed));
}

proptest! {
    #[test]
    fn any_text_is_read_or_refused(text in ".{0,300}") {
        let _ = parse(&text);
    }
}
