//! Bindings at work: what devices say goes in, what actions are comes out.

use vergence_sense::Pose;
use vergence_time::Timestamp;

use crate::bindings::{Bindings, Chooses, Logical};
use crate::curve::Curve;
use crate::dead_zone::Rest;
use crate::filter::{KnobError, Smoother};
use crate::layout::component;

/// What an input says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reading<'a> {
    /// Down or not.
    Button(bool),
    /// −1 to 1, or 0 to 1; of a wheel or a relative axis, any number.
    Axis(f64),
    /// Two numbers.
    Vector([f64; 2]),
    /// Where something is.
    Pose(Pose),
    /// What is pointed at, by a number that the scene knows.
    Pick(Option<u64>),
    /// What was typed since the last time.
    Text(&'a str),
    /// The device is gone: as if it were at rest.
    Gone,
}

/// What an action is.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// Down or not.
    Button(bool),
    /// One number.
    Valuator(f64),
    /// Two numbers.
    Locator([f64; 2]),
    /// Where something is.
    Pose(Pose),
    /// What is pointed at.
    Pick(Option<u64>),
    /// The place among its options.
    Choice(usize),
    /// What was typed last.
    String(String),
}

/// Names an input of one [`Mapper`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InputId(usize);

/// Text is kept up to this many bytes a time.
const LONGEST_TEXT: usize = 4096;

/// The last that an input said.
#[derive(Clone, Debug)]
enum Stored {
    Nothing,
    Number(f64),
    Vector([f64; 2]),
    Pose(Pose),
    Pick(Option<u64>),
    Text(String),
}

#[derive(Clone, Debug)]
struct Source {
    input: usize,
    component: Option<usize>,
}

#[derive(Clone, Debug)]
struct Work {
    action: usize,
    sources: Vec<Source>,
    with: Vec<usize>,
    /// Longer chords on the same input, which hide this one while they are held.
    hidden_by: Vec<usize>,
    press_at: f64,
    release_at: f64,
    rest: Option<Rest>,
    curve: Curve,
    scale: f64,
    smoother: Smoother<2>,
    /// What is smoothed, as last said: it is held until something else is.
    held: [f64; 2],
    chooses: Option<Chooses>,
    /// Its button is down, whether it counts or not.
    is_down: bool,
    /// And it went down while its chord was held and no longer one.
    is_latched: bool,
    out: [f64; 2],
}

impl Work {
    /// Brings what comes out up to `at`. Rest is rest at once, whatever the filter: nothing creeps after a stick is let go.
    fn smooth(&mut self, at: Timestamp) {
        if self.held == [0.0; 2] {
            self.smoother.reset();
        }
        self.out = self.smoother.update(at, self.held);
    }
}

/// Bindings at work. Feeding allocates nothing, except for text.
#[derive(Clone, Debug)]
pub struct Mapper {
    names: Vec<String>,
    stored: Vec<Stored>,
    /// Which works an input touches, as watched or as held.
    touches: Vec<Vec<usize>>,
    works: Vec<Work>,
    by_action: Vec<Vec<usize>>,
    actions: Vec<(String, Logical, usize)>,
    values: Vec<Value>,
    /// How often each has changed.
    changes: Vec<u64>,
    sets: Vec<(String, bool)>,
    options: Vec<usize>,
    changed: Vec<usize>,
}

impl Mapper {
    /// With everything at rest, and all sets active.
    ///
    /// # Errors
    /// Where a filter's knobs are out of their range.
    pub fn new(bindings: &Bindings) -> Result<Self, KnobError> {
        let mut mapper = Self {
            names: Vec::new(),
            stored: Vec::new(),
            touches: Vec::new(),
            works: Vec::new(),
            by_action: Vec::new(),
            actions: Vec::new(),
            values: Vec::new(),
            changes: Vec::new(),
            sets: Vec::new(),
            options: Vec::new(),
            changed: Vec::new(),
        };
        for (action, bound) in bindings.actions().iter().enumerate() {
            let set = mapper.sets.iter().position(|(name, _)| *name == bound.set).unwrap_or_else(|| {
                mapper.sets.push((bound.set.clone(), true));
                mapper.sets.len() - 1
            });
            mapper.actions.push((bound.name.clone(), bound.kind, set));
            mapper.values.push(at_rest(bound.kind));
            mapper.changes.push(0);
            mapper.options.push(bound.options.len());
            let mut own = Vec::with_capacity(bound.binds.len());
            for bind in &bound.binds {
                let place = mapper.works.len();
                let sources = bind.from.inputs().iter().map(|name| mapper.source(name)).collect::<Vec<_>>();
                let with = bind.with.iter().map(|name| mapper.source(name).input).collect::<Vec<_>>();
                for input in sources.iter().map(|source| source.input).chain(with.iter().copied()) {
                    if !mapper.touches[input].contains(&place) {
                        mapper.touches[input].push(place);
                    }
                }
                own.push(place);
                mapper.works.push(Work {
                    action,
                    sources,
                    with,
                    hidden_by: Vec::new(),
                    press_at: bind.press_at,
                    release_at: bind.release_at,
                    rest: bind.rest,
                    curve: bind.curve.clone(),
                    scale: bind.scale,
                    smoother: bind.smoothing.smoother()?,
                    held: [0.0; 2],
                    chooses: bind.chooses,
                    is_down: false,
                    is_latched: false,
                    out: [0.0; 2],
                });
            }
            mapper.by_action.push(own);
        }
        mapper.changed.reserve(mapper.actions.len());
        mapper.hide();
        Ok(mapper)
    }

    /// Finds for each binding the longer chords that hide it, and lets their held inputs touch it.
    fn hide(&mut self) {
        for place in 0..self.works.len() {
            let own = &self.works[place];
            let longer = |other: &Work| {
                self.actions[other.action].2 == self.actions[own.action].2
                    && other.with.len() > own.with.len()
                    && own.with.iter().all(|held| other.with.contains(held))
                    && other.sources.iter().any(|a| own.sources.iter().any(|b| a.input == b.input))
            };
            let hidden_by: Vec<usize> =
                (0..self.works.len()).filter(|other| longer(&self.works[*other])).collect();
            for held in hidden_by.iter().flat_map(|other| self.works[*other].with.clone()).collect::<Vec<_>>()
            {
                if !self.touches[held].contains(&place) {
                    self.touches[held].push(place);
                }
            }
            self.works[place].hidden_by = hidden_by;
        }
    }

    fn source(&mut self, name: &str) -> Source {
        let (name, component) = component(name).map_or((name, None), |(whole, place)| (whole, Some(place)));
        let input = self.names.iter().position(|own| own == name).unwrap_or_else(|| {
            self.names.push(name.to_owned());
            self.stored.push(Stored::Nothing);
            self.touches.push(Vec::new());
            self.names.len() - 1
        });
        Source { input, component }
    }

    /// Other bindings, from now on: what is held down stays held and does nothing new until it is pressed again.
    ///
    /// # Errors
    /// As [`Mapper::new`]; nothing is changed then.
    pub fn replace(&mut self, bindings: &Bindings) -> Result<(), KnobError> {
        let mut next = Self::new(bindings)?;
        for (name, stored) in next.names.iter().zip(&mut next.stored) {
            if let Some(before) = self.names.iter().position(|own| own == name) {
                *stored = self.stored[before].clone();
            }
        }
        for (name, is_active) in &mut next.sets {
            if let Some((_, before)) = self.sets.iter().find(|(own, _)| own == name) {
                *is_active = *before;
            }
        }
        for place in 0..next.works.len() {
            next.works[place].is_down = next.presses(place);
        }
        for (action, (name, kind, _)) in next.actions.iter().enumerate() {
            let before = self.actions.iter().position(|(own, own_kind, _)| own == name && own_kind == kind);
            match (before.map(|before| &self.values[before]), *kind) {
                (Some(Value::Choice(place)), Logical::Choice) if *place < next.options[action] => {
                    next.values[action] = Value::Choice(*place);
                }
                (Some(value), Logical::Pose | Logical::Pick | Logical::String) => {
                    next.values[action] = value.clone();
                }
                _ => {}
            }
        }
        *self = next;
        Ok(())
    }

    /// The input called `name`, where any binding watches it: of a vector the whole, not a component.
    pub fn input(&self, name: &str) -> Option<InputId> {
        self.names.iter().position(|own| own == name).map(InputId)
    }

    /// The inputs that any binding watches: what is not here need not be read.
    pub fn inputs(&self) -> impl Iterator<Item = (InputId, &str)> {
        self.names.iter().enumerate().map(|(place, name)| (InputId(place), &name[..]))
    }

    /// The place of the action called `name`, for [`Mapper::value`].
    pub fn action(&self, name: &str) -> Option<usize> {
        self.actions.iter().position(|(own, ..)| own == name)
    }

    /// What an action is now.
    pub fn value(&self, action: usize) -> Option<&Value> {
        self.values.get(action)
    }

    /// How often an action has changed since these bindings are at work.
    pub fn changes(&self, action: usize) -> u64 {
        self.changes.get(action).copied().unwrap_or(0)
    }

    /// Switches a set on or off: actions of a set that is off are at rest. Gives the actions that changed.
    pub fn activate(&mut self, set: &str, is_active: bool) -> &[usize] {
        self.changed.clear();
        let Some(place) = self.sets.iter().position(|(name, _)| name == set) else { return &[] };
        self.sets[place].1 = is_active;
        for action in 0..self.actions.len() {
            if self.actions[action].2 == place {
                self.settle(action);
            }
        }
        &self.changed
    }

    /// Feeds what an input says at `at`, and gives the actions that changed.
    pub fn feed(&mut self, at: Timestamp, input: InputId, reading: Reading<'_>) -> &[usize] {
        self.changed.clear();
        let InputId(input) = input;
        let Some(stored) = self.stored.get_mut(input) else { return &self.changed };
        let finite = |x: f64| if x.is_finite() { x } else { 0.0 };
        match reading {
            Reading::Button(is_down) => *stored = Stored::Number(f64::from(u8::from(is_down))),
            Reading::Axis(x) => *stored = Stored::Number(finite(x)),
            Reading::Vector(v) => *stored = Stored::Vector(v.map(finite)),
            Reading::Pose(pose) => *stored = Stored::Pose(pose),
            Reading::Pick(hit) => *stored = Stored::Pick(hit),
            Reading::Text(text) => {
                let end = (0..=text.len().min(LONGEST_TEXT)).rev().find(|end| text.is_char_boundary(*end));
                *stored = Stored::Text(text[..end.unwrap_or(0)].to_owned());
            }
            Reading::Gone => *stored = Stored::Nothing,
        }
        for index in 0..self.touches[input].len() {
            let place = self.touches[input][index];
            self.work(at, place, input);
        }
        for index in 0..self.touches[input].len() {
            let place = self.touches[input][index];
            self.settle(self.works[place].action);
        }
        &self.changed
    }

    /// Lets time pass up to `at`, and gives the actions that changed: what is held goes on through its filter. Devices say changes
    /// only; without this, a stick that is held still stays where the filter was when it stopped. Once a frame.
    pub fn advance(&mut self, at: Timestamp) -> &[usize] {
        self.changed.clear();
        for place in 0..self.works.len() {
            let work = &mut self.works[place];
            if work.smoother.is_none() || work.out == work.held {
                continue;
            }
            work.smooth(at);
            self.settle(self.works[place].action);
        }
        &self.changed
    }

    fn number(&self, source: &Source) -> f64 {
        match (&self.stored[source.input], source.component) {
            (Stored::Number(x), _) => *x,
            (Stored::Vector(v), Some(place)) => v[place],
            (Stored::Vector([x, y]), None) => x.hypot(*y),
            _ => 0.0,
        }
    }

    /// Whether what a binding watches is pressed, by its thresholds.
    fn presses(&self, place: usize) -> bool {
        let work = &self.works[place];
        let bound = if work.is_down { work.release_at } else { work.press_at };
        // At a threshold of zero, rest is still rest.
        work.sources.iter().any(|source| self.number(source).abs() >= bound.max(f64::MIN_POSITIVE))
    }

    fn is_held(&self, work: &Work) -> bool {
        work.with.iter().all(|input| self.number(&Source { input: *input, component: None }).abs() >= 0.5)
    }

    /// Whether its chord is held, and no longer one.
    fn counts(&self, place: usize) -> bool {
        let work = &self.works[place];
        self.is_held(work) && !work.hidden_by.iter().any(|other| self.is_held(&self.works[*other]))
    }

    /// Brings one binding up to date after `input` has changed.
    fn work(&mut self, at: Timestamp, place: usize, input: usize) {
        let (kind, counts, presses) =
            (self.actions[self.works[place].action].1, self.counts(place), self.presses(place));
        let is_held = self.is_held(&self.works[place]);
        let watched: [f64; 4] = {
            let work = &self.works[place];
            std::array::from_fn(|i| work.sources.get(i).map_or(0.0, |source| self.number(source)))
        };
        let whole = match (&self.works[place].sources[..], kind) {
            ([one], Logical::Locator) => match self.stored[one.input] {
                Stored::Vector(v) => v,
                Stored::Number(x) => [x, 0.0],
                _ => [0.0; 2],
            },
            ([_, _, _, _], _) => [watched[1] - watched[0], watched[2] - watched[3]],
            ([_, _], _) => [watched[1] - watched[0], 0.0],
            _ => [watched[0], 0.0],
        };
        let is_watched = self.works[place].sources.iter().any(|source| source.input == input);
        let work = &mut self.works[place];
        let was_down = std::mem::replace(&mut work.is_down, presses);
        let pressed_now = presses && !was_down && is_watched;
        match kind {
            Logical::Button => {
                work.is_latched = presses && is_held && (work.is_latched || (pressed_now && counts));
                work.out[0] = f64::from(u8::from(work.is_latched));
            }
            Logical::Choice => {
                if pressed_now && counts {
                    let count = self.options[work.action].max(1);
                    if let (Value::Choice(now), Some(chooses)) = (&self.values[work.action], work.chooses) {
                        let next = match chooses {
                            Chooses::Step(step) => {
                                (*now as i64 + i64::from(step)).rem_euclid(count as i64) as usize
                            }
                            Chooses::Option(option) => option,
                        };
                        work.out = [next as f64, 1.0];
                    }
                }
            }
            Logical::Valuator | Logical::Locator => {
                let raw = if counts { whole } else { [0.0; 2] };
                let [x, y] = match &mut work.rest {
                    Some(rest) => rest.apply(raw.map(|x| x as f32)).map(f64::from),
                    None => raw,
                };
                let length = x.hypot(y);
                // A curve bends what is within the unit disc; a wheel's or a mouse's counts pass.
                let bent = if work.curve == Curve::Linear || length == 0.0 {
                    [x, y]
                } else {
                    let factor = work.curve.apply(length) / length;
                    [x * factor, y * factor]
                };
                work.held = bent.map(|x| x * work.scale);
                work.smooth(at);
            }
            Logical::Pose | Logical::Pick | Logical::String => {
                work.is_latched = counts && is_watched;
            }
        }
    }

    /// Recomputes an action from its bindings.
    fn settle(&mut self, action: usize) {
        let (_, kind, set) = self.actions[action];
        let is_active = self.sets[set].1;
        let own = &self.by_action[action];
        let works = || own.iter().map(|place| &self.works[*place]).filter(|_| is_active);
        let next = match kind {
            Logical::Button => Value::Button(works().any(|work| work.is_latched)),
            Logical::Valuator => {
                let strongest = works().map(|work| work.out[0]).max_by(|a, b| a.abs().total_cmp(&b.abs()));
                Value::Valuator(strongest.unwrap_or(0.0))
            }
            Logical::Locator => {
                let length = |v: &[f64; 2]| v[0].hypot(v[1]);
                let strongest = works().map(|work| work.out).max_by(|a, b| length(a).total_cmp(&length(b)));
                Value::Locator(strongest.unwrap_or([0.0; 2]))
            }
            Logical::Choice => match works().find(|work| work.out[1] > 0.0) {
                Some(work) => Value::Choice(work.out[0] as usize),
                None => self.values[action].clone(),
            },
            Logical::Pose | Logical::Pick | Logical::String => {
                let said =
                    works().find(|work| work.is_latched).map(|work| &self.stored[work.sources[0].input]);
                match (said, kind) {
                    (Some(Stored::Pose(pose)), Logical::Pose) => Value::Pose(*pose),
                    (Some(Stored::Pick(hit)), Logical::Pick) => Value::Pick(*hit),
                    (Some(Stored::Text(text)), Logical::String) => Value::String(text.clone()),
                    (Some(Stored::Nothing), _) => at_rest(kind),
                    _ if !is_active => at_rest(kind),
                    _ => self.values[action].clone(),
                }
            }
        };
        let mut is_new = next != self.values[action];
        for place in &self.by_action[action] {
            let work = &mut self.works[*place];
            match kind {
                // The same word typed twice is said twice.
                Logical::String => is_new |= is_active && std::mem::take(&mut work.is_latched),
                Logical::Pose | Logical::Pick => work.is_latched = false,
                Logical::Choice => work.out = [0.0; 2],
                _ => {}
            }
        }
        if is_new {
            self.values[action] = next;
            self.changes[action] += 1;
            if !self.changed.contains(&action) {
                self.changed.push(action);
            }
        }
    }
}

fn at_rest(kind: Logical) -> Value {
    match kind {
        Logical::Button => Value::Button(false),
        Logical::Valuator => Value::Valuator(0.0),
        Logical::Locator => Value::Locator([0.0; 2]),
        Logical::Pose => Value::Pose(Pose::LOST),
        Logical::Pick => Value::Pick(None),
        Logical::Choice => Value::Choice(0),
        Logical::String => Value::String(String::new()),
    }
}
