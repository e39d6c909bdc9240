//! gilrs on its own thread: one for all the gamepads that this process reads, as long as it reads one.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, SyncSender, TrySendError, channel, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use gilrs::{Axis, Button, EventType, GamepadId, Gilrs, GilrsBuilder, LinuxGamepadExt};
use vergence_time::{Clock, Timestamp};

use super::node::{Kind, Node, look_up_node, nodes, present};
use super::reading::stamped_by_wall_clock;
use crate::claim::Claim;
use crate::found::Found;

/// gilrs is waited for at most this long, so that somebody who comes or goes is seen.
const TURN: Duration = Duration::from_millis(20);
/// The nodes that there are are looked at this often.
const LOOK: Duration = Duration::from_millis(100);
/// What gilrs lists may differ from them for this long.
const GRACE: Duration = Duration::from_millis(300);
/// So many changes may wait for a reader; who is slower is told to look at the pad itself.
const WAITING: usize = 1024;

/// What has changed, by gilrs' name for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Element {
    /// 1 pressed, 0 let go.
    Key(Button),
    /// 0 to 1 of a button's way.
    Way(Button),
    /// −1 to 1, the y axes upwards.
    Axis(Axis),
}

#[derive(Debug)]
pub(super) enum Signal {
    Connected(Box<Node>),
    Changed {
        element: Element,
        value: f32,
        /// The kernel's type and code of the input.
        input: (u16, u16),
        /// By the reader's clock, when the kernel had it, and when gilrs gave it.
        captured: Timestamp,
        arrived: Timestamp,
        /// The kernel's, which is equal for what changed at once; of no other use, for it is of the wall clock.
        stamp: SystemTime,
    },
    /// Everything that was there is said.
    Settled,
    Lost,
}

/// What comes of one pad.
pub(super) struct Subscription {
    pub(super) signals: Receiver<Signal>,
    has_missed: Arc<AtomicBool>,
}

impl Subscription {
    /// Whether something was left out since this was asked last.
    pub(super) fn has_missed(&self) -> bool {
        self.has_missed.swap(false, Ordering::AcqRel)
    }
}

struct Joined {
    path: String,
    place: PathBuf,
    id: GamepadId,
    _claim: Claim,
}

struct Reader {
    wanted: Found,
    mappings: Vec<String>,
    clock: Arc<dyn Clock>,
    signals: SyncSender<Signal>,
    has_missed: Arc<AtomicBool>,
    joined: Option<Joined>,
    /// Said as soon as there is room.
    owed: Option<Signal>,
}

impl Reader {
    fn is_gone(&self) -> bool {
        Arc::strong_count(&self.has_missed) == 1
    }

    /// Says what must not be lost.
    fn say(&mut self, signal: Signal) {
        if let Err(TrySendError::Full(signal)) = self.signals.try_send(signal) {
            self.owed = Some(signal);
        }
    }

    fn change(&self, signal: Signal) {
        if self.signals.try_send(signal).is_err() {
            self.has_missed.store(true, Ordering::Release);
        }
    }

    fn lose(&mut self) {
        if self.joined.take().is_some() {
            self.say(Signal::Lost);
        }
    }
}

static HUB: Mutex<Option<Sender<Reader>>> = Mutex::new(None);

/// What comes of the pad `wanted`, stamped by `clock`, wherever it is plugged in.
///
/// # Errors
/// Where no thread can be started.
pub(super) fn subscribe(
    wanted: &Found,
    mappings: &[String],
    clock: Arc<dyn Clock>,
) -> std::io::Result<Subscription> {
    let (signals, receiver) = sync_channel(WAITING);
    let has_missed = Arc::new(AtomicBool::new(false));
    let mut reader = Reader {
        wanted: wanted.clone(),
        mappings: mappings.to_vec(),
        clock,
        signals,
        has_missed: has_missed.clone(),
        joined: None,
        owed: None,
    };
    let mut hub = HUB.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(running) = &*hub {
        match running.send(reader) {
            Ok(()) => return Ok(Subscription { signals: receiver, has_missed }),
            Err(returned) => reader = returned.0,
        }
    }
    let (sender, readers) = channel();
    std::thread::Builder::new().name("gamepads".to_owned()).spawn(move || Hub::new(readers).run(reader))?;
    *hub = Some(sender);
    Ok(Subscription { signals: receiver, has_missed })
}

struct Hub {
    newcomers: Receiver<Reader>,
    readers: Vec<Reader>,
    gilrs: Option<Gilrs>,
    /// What gilrs was told of which pad is what.
    lines: BTreeSet<String>,
    present: BTreeMap<String, PathBuf>,
    pads: Vec<Node>,
    look_at: Instant,
    differs_since: Option<Instant>,
    /// Nodes that gilrs does not take for gamepads, asked twice.
    refused: BTreeSet<String>,
}

impl Hub {
    fn new(newcomers: Receiver<Reader>) -> Self {
        Self {
            newcomers,
            readers: Vec::new(),
            gilrs: None,
            lines: BTreeSet::new(),
            present: BTreeMap::new(),
            pads: Vec::new(),
            look_at: Instant::now(),
            differs_since: None,
            refused: BTreeSet::new(),
        }
    }

    fn run(mut self, first: Reader) {
        self.readers.push(first);
        loop {
            while let Ok(reader) = self.newcomers.try_recv() {
                self.readers.push(reader);
                self.look_at = Instant::now();
            }
            self.readers.retain(|reader| !reader.is_gone());
            if self.readers.is_empty() {
                let mut hub = HUB.lock().unwrap_or_else(PoisonError::into_inner);
                // Nobody can come while the lock is held.
                match self.newcomers.try_recv() {
                    Ok(reader) => self.readers.push(reader),
                    Err(_) => {
                        *hub = None;
                        return;
                    }
                }
            }
            for reader in &mut self.readers {
                if let Some(signal) = reader.owed.take() {
                    reader.say(signal);
                }
            }
            if Instant::now() >= self.look_at {
                self.look();
                self.look_at = Instant::now() + LOOK;
            }
            self.listen();
        }
    }

    /// Passes on what comes within a turn, until nothing more is there.
    fn listen(&mut self) {
        let start = Instant::now();
        let Some(gilrs) = &mut self.gilrs else { return std::thread::sleep(TURN) };
        let mut event = gilrs.next_event_blocking(Some(TURN));
        if event.is_none() && start.elapsed() < TURN / 4 {
            // The node of a pad that is gone is readable, and gives nothing, until gilrs hears of it.
            std::thread::sleep(Duration::from_millis(1));
        }
        let mut has_changed = false;
        for _ in 0..WAITING {
            let Some(gilrs::Event { id, event: what, time: stamp, .. }) = event else { break };
            let change = match what {
                EventType::ButtonPressed(button, code) => Some((Element::Key(button), 1.0, code)),
                EventType::ButtonReleased(button, code) => Some((Element::Key(button), 0.0, code)),
                EventType::ButtonChanged(button, value, code) => Some((Element::Way(button), value, code)),
                EventType::AxisChanged(axis, value, code) => Some((Element::Axis(axis), value, code)),
                EventType::Connected => {
                    self.look_at = Instant::now();
                    None
                }
                EventType::Disconnected => {
                    self.look_at = Instant::now();
                    self.of(id).for_each(Reader::lose);
                    None
                }
                _ => None,
            };
            if let Some((element, value, code)) = change {
                has_changed = true;
                let code = code.into_u32();
                let input = ((code >> 16) as u16, code as u16);
                for reader in self.of(id) {
                    let arrived = reader.clock.now();
                    let captured = stamped_by_wall_clock(stamp, arrived);
                    reader.change(Signal::Changed { element, value, input, captured, arrived, stamp });
                }
            }
            event = self.gilrs.as_mut().and_then(Gilrs::next_event);
        }
        if has_changed {
            self.settle();
        }
    }

    fn of(&mut self, id: GamepadId) -> impl Iterator<Item = &mut Reader> {
        self.readers.iter_mut().filter(move |reader| reader.joined.as_ref().is_some_and(|own| own.id == id))
    }

    fn settle(&self) {
        self.readers.iter().filter(|reader| reader.joined.is_some()).for_each(|r| r.change(Signal::Settled));
    }

    /// Compares what gilrs lists with what there is, and brings together who waits for a pad that came.
    fn look(&mut self) {
        let present = present();
        if present != self.present || self.gilrs.is_none() {
            self.pads = nodes().into_iter().filter(|node| node.kind == Kind::Gamepad).collect();
            self.present = present;
            self.refused.clear();
            for reader in &mut self.readers {
                let is_there =
                    reader.joined.as_ref().is_none_or(|own| self.present.get(&own.path) == Some(&own.place));
                if !is_there {
                    reader.lose();
                }
            }
        }
        if self.readers.iter().all(|reader| reader.joined.is_some())
            && self.differs_since.is_none()
            && self.agrees()
        {
            return;
        }
        let mappings: Vec<String> = self.readers.iter().flat_map(|reader| reader.mappings.clone()).collect();
        let mut lines = self.lines.clone();
        lines.extend(
            self.pads.iter().map(|pad| pad.layout(&mappings).for_gilrs(&pad.gilrs_guid, &pad.codes).0),
        );
        if self.gilrs.is_none() || lines != self.lines {
            self.lines = lines;
            self.build();
        } else if self.agrees() {
            self.differs_since = None;
        } else if self.differs_since.get_or_insert_with(Instant::now).elapsed() > GRACE {
            log::debug!("gamepads: gilrs lists others than there are; it is made anew");
            self.build();
            let listed = self.listed();
            let all = self.pads.iter().map(|pad| pad.found.path.clone());
            self.refused = all.filter(|path| !listed.contains_key(path)).collect();
        }
        self.join();
    }

    fn listed(&self) -> BTreeMap<String, GamepadId> {
        let pads = self.gilrs.iter().flat_map(|gilrs| gilrs.gamepads());
        pads.map(|(id, pad)| (pad.devpath().to_string_lossy().into_owned(), id)).collect()
    }

    /// Whether gilrs lists every pad that there is, and no node that is gone.
    fn agrees(&self) -> bool {
        let listed = self.listed();
        let mut pads = self.pads.iter().map(|pad| &pad.found.path);
        listed.keys().all(|path| self.present.contains_key(path))
            && pads.all(|path| listed.contains_key(path) || self.refused.contains(path))
    }

    /// Makes gilrs anew. Who reads a pad reads it on, and looks at it for what has changed meanwhile.
    fn build(&mut self) {
        self.differs_since = None;
        self.gilrs = None;
        let lines: Vec<&str> = self.lines.iter().map(String::as_str).collect();
        // As it comes: dead zones are for those who use what is recorded. No environment: what is read does not depend on it.
        let builder = GilrsBuilder::new()
            .with_default_filters(false)
            .with_force_feedback(false)
            .add_included_mappings(false)
            .add_env_mappings(false)
            .add_mappings(&lines.join("\n"));
        match builder.build() {
            Ok(gilrs) => self.gilrs = Some(gilrs),
            Err(error) => log::warn!("gamepads: gilrs: {error}"),
        }
        let listed = self.listed();
        for reader in &mut self.readers {
            let Some(joined) = &mut reader.joined else { continue };
            if let Some(id) = listed.get(&joined.path) {
                joined.id = *id;
                reader.has_missed.store(true, Ordering::Release);
            } else {
                reader.lose();
            }
        }
        self.settle();
    }

    fn join(&mut self) {
        let listed = self.listed();
        for reader in self.readers.iter_mut().filter(|r| r.joined.is_none() && r.owed.is_none()) {
            let Some(node) = look_up_node(&reader.wanted) else { continue };
            let path = node.found.path.clone();
            let (Some(id), Some(place)) = (listed.get(&path), self.present.get(&path)) else { continue };
            let _claim = Claim::on(&path);
            reader.joined = Some(Joined { path, place: place.clone(), id: *id, _claim });
            reader.say(Signal::Connected(Box::new(node)));
        }
    }
}
