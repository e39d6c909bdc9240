//! Which input does which action: read from TOML, changed while the program runs, written back.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use toml::Spanned;
use vergence_config::{Duration, Frequency};

use crate::curve::Curve;
use crate::dead_zone::{DeadZone, Rest, Shape};
use crate::filter::{DoubleExponentialParams, LowPassParams, OneEuroParams, Smoothing};
use crate::layout::{InputKind, Layout, component, input_kind, is_extra_mouse_button};

/// What an action yields: the logical devices of J. Foley and V. Wallace (Proceedings of the IEEE 62, 1974), and poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Logical {
    /// Down or not.
    Button,
    /// One number.
    Valuator,
    /// Two numbers.
    Locator,
    /// Where something is.
    Pose,
    /// What is pointed at.
    Pick,
    /// One of several.
    Choice,
    /// What is typed.
    String,
}

/// Actions, inputs of one action, and inputs held with one, at most.
const MOST: usize = 1024;

#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct RawFile {
    #[serde(default)]
    extra_mouse_buttons: bool,
    #[serde(default)]
    layout: Layout,
    #[serde(default)]
    actions: BTreeMap<String, RawAction>,
}

#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct RawAction {
    kind: Logical,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    label: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    set: Option<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    options: Vec<String>,
    #[serde(default)]
    bind: Vec<Spanned<RawBind>>,
}

#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
struct RawBind {
    #[serde(skip_serializing_if = "Option::is_none")]
    input: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    negative: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    positive: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    left: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    right: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    up: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    down: Option<String>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    with: Vec<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    press_at: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    release_at: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    dead_zone: Option<RawZone>,
    #[serde(skip_serializing_if = "Option::is_none")]
    curve: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    scale: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    filter: Option<RawFilter>,
    #[serde(skip_serializing_if = "Option::is_none")]
    step: Option<i32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    option: Option<String>,
}

#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct RawZone {
    #[serde(default)]
    shape: RawShape,
    #[serde(default = "inner")]
    inner: f32,
    #[serde(default = "outer")]
    outer: f32,
    #[serde(default)]
    hysteresis: f32,
}

fn inner() -> f32 {
    0.15
}

fn outer() -> f32 {
    0.95
}

#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
enum RawShape {
    #[default]
    Radial,
    Axial,
}

/// As text with units, so that it is written back as it was read.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct RawFilter {
    kind: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    cutoff: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    time: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    ahead: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    least_cutoff: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    beta: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    speed_cutoff: Option<String>,
}

/// An action as it is bound.
#[derive(Clone, Debug, PartialEq)]
pub struct BoundAction {
    /// Its name.
    pub name: String,
    /// What people call it.
    pub label: String,
    /// What it yields.
    pub kind: Logical,
    /// Which set it belongs to; `default` where none is named.
    pub set: String,
    /// Of a choice.
    pub options: Vec<String>,
    /// What does it.
    pub binds: Vec<Bind>,
}

/// One way to do an action.
#[derive(Clone, Debug, PartialEq)]
pub struct Bind {
    /// What is watched.
    pub from: Watched,
    /// Inputs that must be held, sorted: a chord.
    pub with: Vec<String>,
    /// An axis counts as pressed from here on.
    pub press_at: f64,
    /// And as released below.
    pub release_at: f64,
    /// What is dead about it.
    pub rest: Option<Rest>,
    /// How it answers.
    pub curve: Curve,
    /// What the answer is multiplied with; negative: the other way round.
    pub scale: f64,
    /// How it is smoothed, last.
    pub smoothing: Smoothing,
    /// Of a choice: what it does.
    pub chooses: Option<Chooses>,
}

/// What is watched.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Watched {
    /// One input.
    One(String),
    /// Two buttons that make an axis: negative, positive.
    Pair([String; 2]),
    /// Four buttons that make a direction: left, right, up, down.
    Four([String; 4]),
}

impl Watched {
    /// The names of what is watched.
    pub fn inputs(&self) -> &[String] {
        match self {
            Self::One(name) => std::slice::from_ref(name),
            Self::Pair(names) => names,
            Self::Four(names) => names,
        }
    }
}

/// What a press does to a choice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Chooses {
    /// So many further, round and round.
    Step(i32),
    /// This one.
    Option(usize),
}

/// Two actions of one set that one input does at once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Conflict {
    /// The input, or the narrower one of two.
    pub input: String,
    /// What is held with it.
    pub with: Vec<String>,
    /// Both.
    pub actions: [String; 2],
}

impl std::fmt::Display for Conflict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for held in &self.with {
            write!(f, "{held} + ")?;
        }
        write!(f, "{} does both {:?} and {:?}", self.input, self.actions[0], self.actions[1])
    }
}

/// Why bindings cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A place in the file.
    #[error(transparent)]
    Config(#[from] vergence_config::Error),
    /// A change names an action that there is not.
    #[error("expected an action, found {0:?}, which is none")]
    NoAction(String),
    /// A change that makes no sense.
    #[error("{0}")]
    Change(String),
    /// A filter's knob is out of its range.
    #[error(transparent)]
    Knob(#[from] crate::filter::KnobError),
    /// Bindings cannot be written as TOML.
    #[error("bindings cannot be written: {0}")]
    Write(#[from] toml::ser::Error),
}

/// All actions and what does them.
#[derive(Clone, Debug, PartialEq)]
pub struct Bindings {
    raw: RawFile,
    path: PathBuf,
    actions: Vec<BoundAction>,
}

impl Bindings {
    /// Reads a file.
    ///
    /// # Errors
    /// As [`Bindings::parse`], and where it cannot be read.
    pub fn read(path: &Path) -> Result<Self, Error> {
        Self::parse(path, &Self::text(path)?)
    }

    /// What is in the file.
    pub(crate) fn text(path: &Path) -> Result<String, Error> {
        let io = |source| vergence_config::Error::Io { path: path.to_owned(), source };
        let found = std::fs::metadata(path).map_err(io)?.len();
        if found > vergence_config::MAX_FILE_BYTES {
            return Err(vergence_config::Error::TooLarge { path: path.to_owned(), found }.into());
        }
        Ok(std::fs::read_to_string(path).map_err(io)?)
    }

    /// Reads text, naming `path` in errors.
    ///
    /// # Errors
    /// With file, line and column: where it is no TOML, an input or a key is unknown, an input cannot do the action, or a knob is out
    /// of its range. Conflicts are no errors: see [`Bindings::conflicts`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, Error> {
        let raw: RawFile = vergence_config::parse(path, text)?;
        let actions = resolved(&raw).map_err(|(offset, message)| {
            Error::Config(vergence_config::invalid_at(path, text, offset, &message))
        })?;
        Ok(Self { raw, path: path.to_owned(), actions })
    }

    /// Sorted by name.
    pub fn actions(&self) -> &[BoundAction] {
        &self.actions
    }

    /// Whose words a menu uses.
    pub fn layout(&self) -> Layout {
        self.raw.layout
    }

    /// Whether a mouse's buttons beyond three are wanted.
    pub fn extra_mouse_buttons(&self) -> bool {
        self.raw.extra_mouse_buttons
    }

    /// Where one input does two actions of a set, with the same inputs held. A chord and its plain input are none: the longer
    /// chord wins.
    pub fn conflicts(&self) -> Vec<Conflict> {
        let mut seen: Vec<(&str, &[String], &str, &str)> = Vec::new();
        let mut found = Vec::new();
        for action in &self.actions {
            for bind in &action.binds {
                for input in bind.from.inputs() {
                    for (other, with, set, name) in &seen {
                        let is_one = overlap(other, input) && *with == bind.with && *set == action.set;
                        if is_one && *name != action.name {
                            let narrower = if input.len() > other.len() { input } else { *other };
                            found.push(Conflict {
                                input: narrower.to_owned(),
                                with: bind.with.clone(),
                                actions: [(*name).to_owned(), action.name.clone()],
                            });
                        }
                    }
                }
            }
            for bind in &action.binds {
                let inputs = bind.from.inputs().iter();
                seen.extend(
                    inputs.map(|input| (&input[..], &bind.with[..], &action.set[..], &action.name[..])),
                );
            }
        }
        found
    }

    /// Lets `input`, while `with` are held, do `action`, in the place number `slot` of its bindings (after the last: one more); other
    /// knobs of that place stay. Gives the conflicts that there are now.
    ///
    /// # Errors
    /// Where there is no such action or slot, or the input cannot do it; nothing is changed then.
    pub fn rebind(
        &mut self,
        action: &str,
        slot: usize,
        input: &str,
        with: &[&str],
    ) -> Result<Vec<Conflict>, Error> {
        let mut raw = self.raw.clone();
        let own = raw.actions.get_mut(action).ok_or_else(|| Error::NoAction(action.to_owned()))?;
        let count = own.bind.len();
        if slot > count {
            let message = format!("expected a binding 0 to {count} of {action:?}, found {slot}");
            return Err(Error::Change(message));
        }
        let mut bind = own.bind.get(slot).map(|bind| bind.get_ref().clone()).unwrap_or_default();
        bind.input = Some(input.to_owned());
        [bind.negative, bind.positive, bind.left, bind.right, bind.up, bind.down] = [const { None }; 6];
        bind.with = with.iter().map(|name| (*name).to_owned()).collect();
        let bind = Spanned::new(0..0, bind);
        if slot == count {
            own.bind.push(bind);
        } else {
            own.bind[slot] = bind;
        }
        self.actions = resolved(&raw).map_err(|(_, message)| Error::Change(message))?;
        self.raw = raw;
        Ok(self.conflicts())
    }

    /// Takes a binding away.
    ///
    /// # Errors
    /// Where there is none.
    pub fn unbind(&mut self, action: &str, slot: usize) -> Result<(), Error> {
        let own = self.raw.actions.get_mut(action).ok_or_else(|| Error::NoAction(action.to_owned()))?;
        if slot >= own.bind.len() {
            return Err(Error::Change(format!("expected a binding of {action:?}, found no number {slot}")));
        }
        own.bind.remove(slot);
        self.actions = resolved(&self.raw).map_err(|(_, message)| Error::Change(message))?;
        Ok(())
    }

    /// As TOML, for [`Bindings::parse`].
    ///
    /// # Errors
    /// Where a value cannot be told in TOML.
    pub fn to_toml(&self) -> Result<String, Error> {
        Ok(toml::to_string(&self.raw)?)
    }

    /// The file that errors name.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// One is the other, or a component of it.
fn overlap(a: &str, b: &str) -> bool {
    let whole = |name: &str| component(name).map(|(whole, _)| whole.to_owned());
    a == b || whole(a).as_deref() == Some(b) || whole(b).as_deref() == Some(a)
}

/// The place in the text, and what is wrong there.
type Wrong = (usize, String);

fn resolved(raw: &RawFile) -> Result<Vec<BoundAction>, Wrong> {
    if raw.actions.len() > MOST {
        return Err((0, format!("expected at most {MOST} actions, found {}", raw.actions.len())));
    }
    let mut actions = Vec::with_capacity(raw.actions.len());
    for (name, action) in &raw.actions {
        if action.bind.len() > MOST || action.options.len() > MOST {
            return Err((0, format!("{name}: expected at most {MOST} bindings and options, found more")));
        }
        if (action.kind == Logical::Choice) == action.options.is_empty() {
            let message = format!("{name}: expected options for a choice, and for nothing else");
            return Err((action.bind.first().map_or(0, |bind| bind.span().start), message));
        }
        let binds = action.bind.iter().map(|bind| {
            let place = bind.span().start;
            bound(bind.get_ref(), action, raw.extra_mouse_buttons)
                .map_err(|message| (place, format!("{name}: {message}")))
        });
        actions.push(BoundAction {
            name: name.clone(),
            label: action.label.clone().unwrap_or_else(|| name.clone()),
            kind: action.kind,
            set: action.set.clone().unwrap_or_else(|| "default".to_owned()),
            options: action.options.clone(),
            binds: binds.collect::<Result<_, _>>()?,
        });
    }
    Ok(actions)
}

fn within(what: &str, value: f64, low: f64, high: f64) -> Result<f64, String> {
    if (low..=high).contains(&value) {
        Ok(value)
    } else {
        Err(format!("{what}: expected {low} to {high}, found {value}"))
    }
}

fn bound(raw: &RawBind, action: &RawAction, extra_mouse_buttons: bool) -> Result<Bind, String> {
    let known = |name: &String| -> Result<InputKind, String> {
        if is_extra_mouse_button(name) && !extra_mouse_buttons {
            return Err(format!("{name}: expected extra_mouse_buttons = true for it, found none"));
        }
        input_kind(name)
            .ok_or_else(|| format!("expected an input such as \"pad.south\" or \"key.a\", found {name:?}"))
    };
    let from = match raw {
        RawBind {
            input: Some(one),
            negative: None,
            positive: None,
            left: None,
            right: None,
            up: None,
            down: None,
            ..
        } => Watched::One(one.clone()),
        RawBind {
            input: None,
            negative: Some(a),
            positive: Some(b),
            left: None,
            right: None,
            up: None,
            down: None,
            ..
        } => Watched::Pair([a.clone(), b.clone()]),
        RawBind {
            input: None,
            negative: None,
            positive: None,
            left: Some(l),
            right: Some(r),
            up: Some(u),
            down: Some(d),
            ..
        } => Watched::Four([l.clone(), r.clone(), u.clone(), d.clone()]),
        _ => {
            return Err(
                "expected either input, or negative and positive, or left, right, up and down".to_owned()
            );
        }
    };
    let kinds = from.inputs().iter().map(known).collect::<Result<Vec<_>, _>>()?;
    use InputKind::{Any, Axis, Button, Pick, Pose, Text, Vector};
    let numbers = [Button, Axis, Vector, Any];
    let fits = match (action.kind, &from) {
        (Logical::Button | Logical::Choice, Watched::One(_)) => numbers.contains(&kinds[0]),
        (Logical::Valuator, Watched::One(_)) => [Button, Axis, Any].contains(&kinds[0]),
        (Logical::Valuator, Watched::Pair(_)) | (Logical::Locator, Watched::Four(_)) => {
            kinds.iter().all(|kind| [Button, Axis, Any].contains(kind))
        }
        (Logical::Locator, Watched::One(_)) => [Vector, Any].contains(&kinds[0]),
        (Logical::Pose, Watched::One(_)) => [Pose, Any].contains(&kinds[0]),
        (Logical::Pick, Watched::One(_)) => [Pick, Any].contains(&kinds[0]),
        (Logical::String, Watched::One(_)) => [Text, Any].contains(&kinds[0]),
        _ => false,
    };
    if !fits {
        return Err(format!("expected an input for a {:?}, found {}", action.kind, from.inputs().join(", "))
            .to_lowercase());
    }
    if raw.with.len() > 8 {
        return Err(format!("with: expected at most 8 inputs, found {}", raw.with.len()));
    }
    for held in &raw.with {
        if !numbers.contains(&known(held)?) || from.inputs().contains(held) {
            return Err(format!("with: expected another button or axis, found {held:?}"));
        }
    }
    let mut with = raw.with.clone();
    with.sort();
    with.dedup();
    let press_at = within("press_at", raw.press_at.unwrap_or(0.5), 1e-6, 1.0)?;
    let release_at = within("release_at", raw.release_at.unwrap_or(0.8 * press_at), 0.0, press_at)?;
    let rest = raw.dead_zone.as_ref().map(|zone| {
        let shape = match zone.shape {
            RawShape::Radial => Shape::Radial,
            RawShape::Axial => Shape::Axial,
        };
        DeadZone::new(zone.inner, zone.outer).and_then(|own| Rest::new(own, shape, zone.hysteresis))
    });
    let chooses = match (action.kind, raw.step, &raw.option) {
        (Logical::Choice, Some(step), None) => Some(Chooses::Step(step)),
        (Logical::Choice, None, Some(option)) => {
            let place = action.options.iter().position(|own| own == option);
            let place =
                place.ok_or_else(|| format!("expected one of {:?}, found {option:?}", action.options))?;
            Some(Chooses::Option(place))
        }
        (Logical::Choice, ..) => return Err("expected either step or option for a choice".to_owned()),
        (_, None, None) => None,
        _ => return Err("expected step or option for a choice only".to_owned()),
    };
    Ok(Bind {
        from,
        with,
        press_at,
        release_at,
        rest: rest.transpose().map_err(|error| error.to_string())?,
        curve: raw
            .curve
            .as_deref()
            .map_or(Ok(Curve::Linear), Curve::parse)
            .map_err(|e| format!("curve: {e}"))?,
        scale: within("scale", raw.scale.unwrap_or(1.0), -1e6, 1e6)?,
        smoothing: raw.filter.as_ref().map_or(Ok(Smoothing::None), smoothing)?,
        chooses,
    })
}

fn smoothing(raw: &RawFilter) -> Result<Smoothing, String> {
    let hertz = |text: &Option<String>, default: f64| {
        text.as_ref().map_or(Ok(default), |text| text.parse::<Frequency>().map(Frequency::hertz))
    };
    let seconds = |text: &Option<String>, default: f64| {
        text.as_ref().map_or(Ok(default), |text| text.parse::<Duration>().map(Duration::seconds))
    };
    let given = [
        ("cutoff", raw.cutoff.is_some(), "low-pass"),
        ("time", raw.time.is_some(), "double-exponential"),
        ("ahead", raw.ahead.is_some(), "double-exponential"),
        ("least_cutoff", raw.least_cutoff.is_some(), "one-euro"),
        ("beta", raw.beta.is_some(), "one-euro"),
        ("speed_cutoff", raw.speed_cutoff.is_some(), "one-euro"),
    ];
    if let Some((knob, ..)) = given.iter().find(|(_, is_given, of)| *is_given && *of != raw.kind) {
        return Err(format!("filter: expected knobs of {:?}, found {knob}", raw.kind));
    }
    let low_pass = LowPassParams::default();
    let double = DoubleExponentialParams::default();
    let one_euro = OneEuroParams::default();
    let smoothing = match &raw.kind[..] {
        "none" => Smoothing::None,
        "low-pass" => {
            Smoothing::LowPass(LowPassParams { cutoff_hz: hertz(&raw.cutoff, low_pass.cutoff_hz)? })
        }
        "double-exponential" => Smoothing::DoubleExponential(DoubleExponentialParams {
            time_s: seconds(&raw.time, double.time_s)?,
            ahead_s: seconds(&raw.ahead, double.ahead_s)?,
        }),
        "one-euro" => Smoothing::OneEuro(OneEuroParams {
            least_cutoff_hz: hertz(&raw.least_cutoff, one_euro.least_cutoff_hz)?,
            beta: raw.beta.unwrap_or(one_euro.beta),
            speed_cutoff_hz: hertz(&raw.speed_cutoff, one_euro.speed_cutoff_hz)?,
        }),
        other => {
            return Err(format!(
                "filter: expected none, low-pass, double-exponential or one-euro, found {other:?}"
            ));
        }
    };
    smoothing.fault().map_or(Ok(smoothing), |fault| Err(format!("filter: {fault}")))
}
