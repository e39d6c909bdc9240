//! `vergence devices bindings` and `devices monitor --bindings`: what actions are, by a file that may change meanwhile.

use std::path::{Path, PathBuf};
use std::time::Instant;

use vergence_action::{Bindings, BoundAction, Change, Conflict, LiveBindings, Value, Wiring, label};
use vergence_sense::{Reading, Sample, SourceStream};
use vergence_time::Timestamp;

use crate::devices::{Opened, listed, pose_words};
use crate::failure::Failure;

/// Reads a file of bindings: its actions, what does each, and where one input does two (exit status 1 there)
#[derive(clap::Args)]
pub struct Check {
    /// Bindings (TOML); the keys are in crates/vergence-action/README.md
    file: PathBuf,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
}

fn failed(error: &vergence_action::Error) -> Failure {
    match error {
        vergence_action::Error::Config(vergence_config::Error::Io { source, .. })
            if source.kind() == std::io::ErrorKind::NotFound =>
        {
            Failure::call(error)
        }
        _ => Failure::work(error),
    }
}

/// What does an action: `Left stick or W`.
fn inputs(action: &BoundAction, bindings: &Bindings) -> String {
    let each = action.binds.iter().map(|bind| {
        let held = bind.with.iter().map(|name| format!("{} + ", label(name, bindings.layout())));
        let watched: Vec<&str> =
            bind.from.inputs().iter().map(|name| label(name, bindings.layout())).collect();
        format!("{}{}", held.collect::<String>(), watched.join("/"))
    });
    each.collect::<Vec<_>>().join(" or ")
}

impl Check {
    pub fn run(&self) -> Result<(), Failure> {
        let bindings = Bindings::read(&self.file).map_err(|error| failed(&error))?;
        let conflicts: Vec<String> = bindings.conflicts().iter().map(Conflict::to_string).collect();
        if self.json {
            let action = |action: &BoundAction| {
                let kind = format!("{:?}", action.kind).to_lowercase();
                serde_json::json!({
                    "name": action.name, "label": action.label, "set": action.set, "kind": kind,
                    "inputs": inputs(action, &bindings),
                })
            };
            let actions: Vec<_> = bindings.actions().iter().map(action).collect();
            println!("{}", serde_json::json!({ "actions": actions, "conflicts": conflicts }));
        } else {
            for action in bindings.actions() {
                let kind = format!("{:?}", action.kind).to_lowercase();
                println!("{:24} {kind:9} {}", action.name, inputs(action, &bindings));
            }
            conflicts.iter().for_each(|conflict| println!("conflict: {conflict}"));
        }
        match conflicts.len() {
            0 => Ok(()),
            count => Err(Failure::Work(format!("{}: {count} conflicts", self.file.display()))),
        }
    }
}

/// How often the file is looked at, seconds.
const LOOK_S: f64 = 0.2;

/// Bindings at work on the devices of a monitor.
pub struct Actions {
    live: LiveBindings,
    wirings: Vec<Wiring>,
    looked_at: Instant,
    /// How often the file was read.
    reads: u32,
    /// Why it was not read the last time it changed.
    refused: Option<String>,
}

impl Actions {
    pub fn read(path: &Path) -> Result<Self, Failure> {
        let live = LiveBindings::open(path).map_err(|error| failed(&error))?;
        Ok(Self { live, wirings: Vec::new(), looked_at: Instant::now(), reads: 1, refused: None })
    }

    /// Whether a mouse's buttons beyond three are wanted.
    pub fn extra_mouse_buttons(&self) -> bool {
        self.live.bindings().extra_mouse_buttons()
    }

    /// Wires the devices, in their order.
    pub fn wire(&mut self, opened: &[Opened]) {
        let wiring = |device: &Opened| {
            let mut wiring = Wiring::new(device.device.adapter, &device.name, device.source.streams());
            wiring.connect(self.live.mapper());
            wiring
        };
        self.wirings = opened.iter().map(wiring).collect();
    }

    pub fn appears(&mut self, device: usize, place: usize, stream: &SourceStream) {
        self.wirings[device].appears(place, stream, self.live.mapper());
    }

    pub fn take(&mut self, device: usize, stream: usize, sample: &Sample<Reading<'_>>) {
        self.wirings[device].take(stream, sample, self.live.mapper_mut());
    }

    /// Before each round of the devices: lets time pass, and looks at the file now and then.
    pub fn advance(&mut self, now: Timestamp) {
        for wiring in &mut self.wirings {
            wiring.begin_frame(now, self.live.mapper_mut());
        }
        self.live.mapper_mut().advance(now);
        if self.looked_at.elapsed().as_secs_f64() < LOOK_S {
            return;
        }
        self.looked_at = Instant::now();
        match self.live.look() {
            None => {}
            Some(Change::Read) => {
                (self.reads, self.refused) = (self.reads + 1, None);
                let mapper = self.live.mapper();
                self.wirings.iter_mut().for_each(|wiring| wiring.connect(mapper));
            }
            Some(Change::Refused(error)) => self.refused = Some(error.to_string()),
        }
    }

    /// The table of actions, with what is wrong with the bindings below.
    pub fn draw(&self) -> String {
        let (bindings, mapper) = (self.live.bindings(), self.live.mapper());
        let times = if self.reads == 1 { String::new() } else { format!(", read {} times", self.reads) };
        let mut text = format!("{}{times}\n", bindings.path().display());
        text += &format!("  {:24} {:9} {:>7}  {:28} inputs\n", "action", "kind", "changes", "value");
        for (place, action) in bindings.actions().iter().enumerate() {
            let kind = format!("{:?}", action.kind).to_lowercase();
            let value = mapper.value(place).map_or_else(String::new, |value| words(value, action));
            let (name, changes, inputs) = (&action.name, mapper.changes(place), inputs(action, bindings));
            text += &format!("  {name:24} {kind:9} {changes:>7}  {value:28} {inputs}\n");
        }
        for conflict in bindings.conflicts() {
            text += &format!("  conflict: {conflict}\n");
        }
        let unheard = |name: &str| {
            // Keys have streams from when they are first pressed.
            let may_come = name.starts_with("key.") && self.names().any(|name| name.starts_with("mouse."));
            !may_come && !self.names().any(|own| own == name)
        };
        let missing: Vec<&str> = mapper.inputs().map(|(_, name)| name).filter(|name| unheard(name)).collect();
        if !missing.is_empty() {
            text += &format!("  no device here has {}\n", missing.join(", "));
        }
        if let Some(why) = &self.refused {
            text += &format!("  not read: {why}\n");
        }
        text
    }

    fn names(&self) -> impl Iterator<Item = &str> {
        self.wirings.iter().flat_map(Wiring::names)
    }
}

/// What an action is, in a few words.
fn words(value: &Value, action: &BoundAction) -> String {
    match value {
        Value::Button(true) => "pressed".into(),
        Value::Button(false) => "released".into(),
        Value::Valuator(x) => listed(&[*x]),
        Value::Locator(v) => listed(v),
        Value::Pose(pose) => pose_words(pose),
        Value::Pick(None) => "nothing".into(),
        Value::Pick(Some(hit)) => hit.to_string(),
        Value::Choice(place) => action.options.get(*place).cloned().unwrap_or_default(),
        Value::String(text) => format!("{text:?}"),
    }
}
