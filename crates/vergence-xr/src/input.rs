//! Actions: from names to what the hands do now.

use openxr::{Path, Posef, sys};
use vergence_action::{Action, ActionSet, Kind, PROFILES, suggestions};
use vergence_sense::{Axis, Body, Button, ControlState, Gaze, Hand, Haptic, Pose, Said, Vector2};
use vergence_time::Timestamp;

use crate::Connection;
use crate::convert;
use crate::error::{Error, In};
use crate::list::list;
use crate::tap::{Call, Ear, raw_location};

type Session = openxr::Session<openxr::Vulkan>;

/// What an action reads now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reading {
    /// Where the hand, or the ray from it, is in LOCAL space.
    Pose(Pose),
    /// Pressed or not.
    Button(Button),
    /// 0…1.
    Axis(Axis),
    /// A direction.
    Vector2(Vector2),
    /// Takes pulses, reads nothing.
    Haptic,
}

enum Handle {
    Pose(openxr::Action<Posef>, [openxr::Space; 2]),
    Button(openxr::Action<bool>),
    Axis(openxr::Action<f32>),
    Vector2(openxr::Action<openxr::Vector2f>),
    Haptic(openxr::Action<openxr::Haptic>),
}

/// What is read, for which instant, and who hears of it.
struct Heard<'a> {
    body: Body,
    at: Timestamp,
    ear: &'a mut Ear,
}

/// The actions of a session, attached to it.
pub(crate) struct Input {
    set: openxr::ActionSet,
    actions: Vec<Action>,
    handles: Vec<Handle>,
    /// In the order of the actions; left, right.
    readings: Vec<[Reading; 2]>,
    hands: [Path; 2],
    gaze: Option<(openxr::Action<Posef>, openxr::Space)>,
    gaze_pose: Pose,
    gaze_sampled: Option<Timestamp>,
    accepted: Vec<&'static str>,
}

const GAZE_PROFILE: &str = "/interaction_profiles/ext/eye_gaze_interaction";
const GAZE_PATH: &str = "/user/eyes_ext/input/gaze_ext/pose";

impl Input {
    /// Creates the actions, tells the runtime which devices they are meant for, and attaches them to the session.
    /// `None` where there is nothing to create. A profile that the runtime refuses is left out, never fatal.
    pub(crate) fn new(
        connection: &Connection,
        session: &Session,
        set: &ActionSet,
        eye_gaze: bool,
    ) -> Result<Option<Self>, Error> {
        let eye_gaze = eye_gaze && connection.sees_gaze();
        if set.actions.is_empty() && !eye_gaze {
            return Ok(None);
        }
        let instance = &connection.instance;
        let path = |text: &str| instance.string_to_path(text).during("xrStringToPath");
        let hands = [path("/user/hand/left")?, path("/user/hand/right")?];
        let (name, label) = if set.name.is_empty() { ("gaze", "Gaze") } else { (set.name, set.label) };
        let xr_set = instance.create_action_set(name, label, 0).during("xrCreateActionSet")?;

        let mut handles = Vec::with_capacity(set.actions.len());
        for action in &set.actions {
            handles.push(create(session, &xr_set, action, &hands)?);
        }
        let gaze = if eye_gaze {
            let action = xr_set.create_action::<Posef>("gaze", "Gaze", &[]).during("xrCreateAction")?;
            let binding = openxr::Binding::new(&action, path(GAZE_PATH)?);
            match instance.suggest_interaction_profile_bindings(path(GAZE_PROFILE)?, &[binding]) {
                Ok(()) => Some(action),
                Err(
                    result @ (openxr::sys::Result::ERROR_INSTANCE_LOST
                    | openxr::sys::Result::ERROR_SESSION_LOST),
                ) => return Err(Error::of("xrSuggestInteractionProfileBindings", result)),
                Err(result) => {
                    log::warn!("eye gaze is not available: {result}");
                    None
                }
            }
        } else {
            None
        };
        let accepted = suggest(connection, set, &handles)?;
        session.attach_action_sets(&[&xr_set]).during("xrAttachSessionActionSets")?;
        let gaze = gaze
            .map(|action| {
                let space = action.create_space(session, Path::NULL, convert::IDENTITY);
                space.during("xrCreateActionSpace").map(|space| (action, space))
            })
            .transpose()?;
        let readings = handles.iter().map(|handle| [handle.nothing(); 2]).collect();
        Ok(Some(Self {
            set: xr_set,
            actions: set.actions.clone(),
            handles,
            readings,
            hands,
            gaze,
            gaze_pose: Pose::LOST,
            gaze_sampled: None,
            accepted,
        }))
    }

    /// Reads everything for the instant `time`, in LOCAL space. Where the session has no input, nothing is known.
    pub(crate) fn sync(
        &mut self,
        session: &Session,
        local: &openxr::Space,
        at: Timestamp,
        ear: &mut Ear,
    ) -> Result<(), Error> {
        ear.answer(Call::SyncActions, session.sync_actions(&[openxr::ActiveActionSet::new(&self.set)]))?;
        let time = openxr::Time::from_nanos(at.as_nanos());
        for (action, (handle, readings)) in self.handles.iter().zip(&mut self.readings).enumerate() {
            for (hand, reading) in Hand::BOTH.into_iter().zip(readings) {
                let path = self.hands[hand.index()];
                let action = action as u16;
                let heard = Heard { body: Body::Action(action, hand), at, ear: &mut *ear };
                *reading = handle.read(session, local, path, hand.index(), time, heard)?;
                let state = match *reading {
                    Reading::Button(button) => ControlState::Button(button),
                    Reading::Axis(axis) => ControlState::Axis(axis),
                    Reading::Vector2(vector) => ControlState::Vector2(vector),
                    Reading::Pose(_) | Reading::Haptic => continue,
                };
                ear.hear(|| Said::Control { action, hand, at, state });
            }
        }
        if let Some((action, space)) = &self.gaze {
            let is_active = ear.answer(Call::GetActionStatePose, action.is_active(session, Path::NULL))?;
            (self.gaze_pose, self.gaze_sampled) = (Pose::LOST, None);
            if is_active {
                let (located, sampled) = locate_gaze(session, space, local, time);
                let located = ear.answer(Call::LocateSpace, located)?;
                let flags = located.location_flags;
                let location = raw_location(flags, &located.pose);
                ear.hear(|| Said::Place { of: Body::Gaze, at, location });
                self.gaze_pose = convert::pose(flags, &located.pose);
                self.gaze_sampled = sampled;
            }
        }
        Ok(())
    }

    pub(crate) fn index(&self, name: &str) -> Option<usize> {
        self.actions.iter().position(|action| action.name == name)
    }

    pub(crate) fn reading(&self, action: usize, hand: Hand) -> Option<Reading> {
        self.readings.get(action).map(|readings| readings[hand.index()])
    }

    pub(crate) fn reads_gaze(&self) -> bool {
        self.gaze.is_some()
    }

    pub(crate) fn gaze(&self) -> Option<Gaze> {
        Gaze::of(&self.gaze_pose)
    }

    /// When the gaze was measured, on the runtime's clock, where that says it.
    pub(crate) fn gaze_sampled(&self) -> Option<Timestamp> {
        self.gaze_sampled
    }

    pub(crate) fn accepted_profiles(&self) -> &[&'static str] {
        &self.accepted
    }

    pub(crate) fn pulse(
        &self,
        session: &Session,
        action: usize,
        hand: Hand,
        haptic: &Haptic,
        ear: &mut Ear,
    ) -> Result<(), Error> {
        let Some(Handle::Haptic(action)) = self.handles.get(action) else { return Ok(()) };
        let duration = haptic
            .duration
            .map_or(openxr::Duration::MIN_HAPTIC, |d| openxr::Duration::from_nanos(d.as_nanos().max(0)));
        let vibration = openxr::HapticVibration::new()
            .duration(duration)
            .frequency(haptic.frequency_hz.unwrap_or(openxr::FREQUENCY_UNSPECIFIED))
            .amplitude(haptic.amplitude.clamp(0.0, 1.0));
        let applied = action.apply_feedback(session, self.hands[hand.index()], &vibration);
        ear.answer(Call::ApplyHapticFeedback, applied)
    }

    /// Which device a hand holds now, for people.
    pub(crate) fn device(&self, session: &Session, hand: Hand) -> Option<String> {
        let path = session.current_interaction_profile(self.hands[hand.index()]).ok()?;
        if path == Path::NULL {
            return None;
        }
        let instance = session.instance();
        let to_string = instance.fp().path_to_string;
        let chars = list("xrPathToString", 0, |capacity, count, chars: *mut std::ffi::c_char| {
            // SAFETY: the instance lives; `chars` is null or has `capacity` elements.
            unsafe { to_string(instance.as_raw(), path, capacity, count, chars) }
        })
        .ok()?;
        let bytes: Vec<u8> = chars.iter().take_while(|&&c| c != 0).map(|&c| c as u8).collect();
        let text = String::from_utf8_lossy(&bytes).into_owned();
        let known = PROFILES.iter().find(|profile| profile.path == text);
        Some(known.map_or(text, |profile| profile.name.to_owned()))
    }
}

/// Where the eyes look, and for when the runtime knows that: the tracker's own rate is not the display's.
fn locate_gaze(
    session: &Session,
    space: &openxr::Space,
    local: &openxr::Space,
    time: openxr::Time,
) -> (Result<sys::SpaceLocation, sys::Result>, Option<Timestamp>) {
    let mut sampled = sys::EyeGazeSampleTimeEXT {
        ty: sys::EyeGazeSampleTimeEXT::TYPE,
        next: std::ptr::null_mut(),
        time: sys::Time::from_nanos(0),
    };
    let mut location = sys::SpaceLocation {
        ty: sys::SpaceLocation::TYPE,
        next: (&raw mut sampled).cast(),
        location_flags: sys::SpaceLocationFlags::EMPTY,
        pose: convert::IDENTITY,
    };
    let locate = session.instance().fp().locate_space;
    // SAFETY: both spaces are of the session, which lives; the structures say what they are and live through the call.
    let result = unsafe { locate(space.as_raw(), local.as_raw(), time, &raw mut location) };
    if result.into_raw() < 0 {
        return (Err(result), None);
    }
    // Zero is said where nothing was measured.
    let sampled = Some(sampled.time.as_nanos()).filter(|nanos| *nanos != 0);
    (Ok(location), sampled.map(Timestamp::from_nanos))
}

fn create(
    session: &Session,
    set: &openxr::ActionSet,
    action: &Action,
    hands: &[Path; 2],
) -> Result<Handle, Error> {
    let call = "xrCreateAction";
    let Action { name, label, .. } = *action;
    Ok(match action.kind {
        Kind::Pose => {
            let xr_action = set.create_action::<Posef>(name, label, hands).during(call)?;
            let space = |hand: Path| {
                xr_action.create_space(session, hand, convert::IDENTITY).during("xrCreateActionSpace")
            };
            let spaces = [space(hands[0])?, space(hands[1])?];
            Handle::Pose(xr_action, spaces)
        }
        Kind::Button => Handle::Button(set.create_action(name, label, hands).during(call)?),
        Kind::Axis => Handle::Axis(set.create_action(name, label, hands).during(call)?),
        Kind::Vector2 => Handle::Vector2(set.create_action(name, label, hands).during(call)?),
        Kind::Haptic => Handle::Haptic(set.create_action(name, label, hands).during(call)?),
    })
}

/// Names of the devices whose suggestions the runtime took.
fn suggest(connection: &Connection, set: &ActionSet, handles: &[Handle]) -> Result<Vec<&'static str>, Error> {
    let mut accepted = Vec::new();
    if set.actions.is_empty() {
        return Ok(accepted);
    }
    let instance = &connection.instance;
    for profile in &PROFILES {
        if profile.extension.is_some_and(|extension| !connection.has(extension)) {
            continue;
        }
        let told = || -> Result<(), openxr::sys::Result> {
            let mut bindings = Vec::new();
            for suggestion in suggestions(profile, &set.actions) {
                let path = instance.string_to_path(&suggestion.path())?;
                bindings.push(handles[suggestion.action].binding(path));
            }
            instance.suggest_interaction_profile_bindings(instance.string_to_path(profile.path)?, &bindings)
        };
        match told() {
            Ok(()) => accepted.push(profile.name),
            Err(
                result @ (openxr::sys::Result::ERROR_INSTANCE_LOST | openxr::sys::Result::ERROR_SESSION_LOST),
            ) => {
                return Err(Error::of("xrSuggestInteractionProfileBindings", result));
            }
            Err(result) => log::info!("the runtime does not take suggestions for {}: {result}", profile.name),
        }
    }
    if accepted.is_empty() {
        log::warn!("the runtime takes no suggestion for any known device: the hands do nothing");
    }
    Ok(accepted)
}

impl Handle {
    fn binding(&self, path: Path) -> openxr::Binding<'_> {
        match self {
            Self::Pose(action, _) => openxr::Binding::new(action, path),
            Self::Button(action) => openxr::Binding::new(action, path),
            Self::Axis(action) => openxr::Binding::new(action, path),
            Self::Vector2(action) => openxr::Binding::new(action, path),
            Self::Haptic(action) => openxr::Binding::new(action, path),
        }
    }

    /// What is read where nothing is known.
    const fn nothing(&self) -> Reading {
        match self {
            Self::Pose(..) => Reading::Pose(Pose::LOST),
            Self::Button(_) => Reading::Button(Button(None)),
            Self::Axis(_) => Reading::Axis(Axis(None)),
            Self::Vector2(_) => Reading::Vector2(Vector2(None)),
            Self::Haptic(_) => Reading::Haptic,
        }
    }

    fn read(
        &self,
        session: &Session,
        local: &openxr::Space,
        hand: Path,
        hand_index: usize,
        time: openxr::Time,
        heard: Heard<'_>,
    ) -> Result<Reading, Error> {
        let Heard { body, at, ear } = heard;
        Ok(match self {
            Self::Pose(action, spaces) => {
                if ear.answer(Call::GetActionStatePose, action.is_active(session, hand))? {
                    let place = ear.answer(Call::LocateSpace, spaces[hand_index].locate(local, time))?;
                    let location = raw_location(place.location_flags, &place.pose);
                    ear.hear(|| Said::Place { of: body, at, location });
                    Reading::Pose(convert::pose(place.location_flags, &place.pose))
                } else {
                    self.nothing()
                }
            }
            Self::Button(action) => {
                let state = ear.answer(Call::GetActionStateBoolean, action.state(session, hand))?;
                Reading::Button(Button(state.is_active.then_some(state.current_state)))
            }
            Self::Axis(action) => {
                let state = ear.answer(Call::GetActionStateFloat, action.state(session, hand))?;
                Reading::Axis(Axis(state.is_active.then_some(state.current_state)))
            }
            Self::Vector2(action) => {
                let state = ear.answer(Call::GetActionStateVector2f, action.state(session, hand))?;
                let value = [state.current_state.x, state.current_state.y];
                Reading::Vector2(Vector2(state.is_active.then_some(value)))
            }
            Self::Haptic(_) => Reading::Haptic,
        })
    }
}
