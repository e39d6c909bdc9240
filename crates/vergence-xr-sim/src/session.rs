//! Sessions and their states.

use std::ffi::c_void;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use openxr_sys as sys;
use vergence_geom::Rigid;
use vergence_time::{Span, Timestamp};

use crate::config::{ClockMode, Command};
use crate::event::Event;
use crate::extension::Extension;
use crate::ffi::{In, Out, XrResult};
use crate::frame::Frames;
use crate::graphics::Graphics;
use crate::handle::{self, Object};
use crate::headset::Profile;
use crate::input::Input;
use crate::instance::Instance;
use crate::motion::{Next, Presence, Replay, Tracked, yaw_of};
use crate::system::{check_system, check_view_configuration};

pub(crate) struct Session {
    pub handle: sys::Session,
    pub instance: Arc<Instance>,
    /// `None` in a headless session.
    pub graphics: Option<Graphics>,
    state: Mutex<SessionState>,
    /// Signalled when a frame begins, and when the session ends.
    pub frame_begun: Condvar,
}

pub(crate) struct SessionState {
    state: sys::SessionState,
    pub running: bool,
    /// The end was asked for: IDLE will be followed by EXITING.
    exiting: bool,
    pub lost: bool,
    presence: Presence,
    /// Whether the lenses hide nothing of what the profile says.
    pub hides_nothing: bool,
    /// Recentrings of the motion that were followed.
    recentrings: u64,
    /// When the session began for the first time: motion time 0.
    begun_at: Option<Timestamp>,
    pub frames: Frames,
    pub rate_hz: f64,
    pub stage_from_local: Rigid,
    /// The origin of LOCAL moves at this instant.
    pending_local: Option<(Timestamp, Rigid)>,
    pub input: Input,
}

impl Object for Session {
    type Handle = sys::Session;
}

/// A session that is not lost, on an instance that is not lost.
///
/// # Errors
/// `XR_ERROR_HANDLE_INVALID`, `XR_ERROR_INSTANCE_LOST`, `XR_ERROR_SESSION_LOST`.
pub(crate) fn get(handle: sys::Session) -> XrResult<Arc<Session>> {
    let session = handle::get::<Session>(handle)?;
    session.check_lost()?;
    Ok(session)
}

impl Session {
    pub(crate) fn lock(&self) -> MutexGuard<'_, SessionState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn check_lost(&self) -> XrResult<()> {
        self.instance.check_lost()?;
        if self.lock().lost { Err(sys::Result::ERROR_SESSION_LOST) } else { Ok(()) }
    }

    fn enter(&self, inner: &mut SessionState, state: sys::SessionState) {
        if inner.state == state {
            return;
        }
        inner.state = state;
        let time = self.instance.clock.now();
        self.instance.push_event(Event::StateChanged { session: self.handle, state, time });
    }

    /// Goes from wherever a running session is to STOPPING, through every state between.
    fn stop(&self, inner: &mut SessionState) {
        use sys::SessionState as S;
        if !inner.running || inner.state == S::STOPPING {
            return;
        }
        if inner.state == S::FOCUSED {
            self.enter(inner, S::VISIBLE);
        }
        if matches!(inner.state, S::VISIBLE | S::READY) {
            self.enter(inner, S::SYNCHRONIZED);
        }
        self.enter(inner, S::STOPPING);
    }

    /// The recording that decides what happens, where there is one that is not over.
    pub(crate) fn replay(&self) -> Option<&Replay> {
        self.instance.config.motion.replay().filter(|replay| !replay.is_exhausted())
    }

    /// Lets the next event of the recording happen; called where the application asks for events and none waits.
    pub(crate) fn follow_replay(&self) {
        let Some(replay) = self.replay() else { return };
        match replay.next() {
            Next::Event(event) => self.happen(&event),
            // A loss shows in the next call that waits for a frame.
            Next::Frame | Next::Lost => {}
            Next::End => {
                replay.exhaust();
                self.ask_to_exit(&mut self.lock());
            }
        }
    }

    /// The recording has no further frame in this session: it was lost there, or the recording was cut off.
    ///
    /// # Errors
    /// `XR_ERROR_SESSION_LOST`.
    pub(crate) fn leave_replay(&self, replay: &Replay) -> XrResult<()> {
        match replay.next() {
            Next::Lost => {
                self.lock().lost = true;
                Err(sys::Result::ERROR_SESSION_LOST)
            }
            _ => {
                replay.exhaust();
                self.ask_to_exit(&mut self.lock());
                Ok(())
            }
        }
    }

    /// One event of the recording.
    fn happen(&self, event: &vergence_sense::Event) {
        let session = self.handle;
        let time = event.at.unwrap_or(self.instance.clock.now());
        let said = match &*event.name {
            "session_state" => {
                let Some(state) = session_state(&event.text) else { return };
                let inner = &mut *self.lock();
                inner.state = state;
                inner.lost |= state == sys::SessionState::LOSS_PENDING;
                Event::StateChanged { session, state, time }
            }
            "space_changing" => {
                let space = match &*event.text {
                    "LOCAL" => sys::ReferenceSpaceType::LOCAL,
                    "LOCAL_FLOOR" => sys::ReferenceSpaceType::LOCAL_FLOOR,
                    "STAGE" => sys::ReferenceSpaceType::STAGE,
                    _ => return,
                };
                Event::LocalSpaceChanging { session, space, time, pose: sys::Posef::IDENTITY }
            }
            "interaction_profile_changed" => Event::InteractionProfileChanged { session },
            "refresh_rate_changed" => {
                Event::RefreshRateChanged { from_hz: event.before as f32, to_hz: event.after as f32 }
            }
            "visibility_mask_changed" => Event::VisibilityMaskChanged { session },
            "instance_loss_pending" => Event::InstanceLossPending { time },
            "events_lost" => {
                self.instance.lock().events.lose(event.after as u32);
                return;
            }
            _ => return,
        };
        self.instance.push_event(said);
    }

    /// One step towards what the user's attention allows: called at the end of each frame.
    pub(crate) fn step(&self, inner: &mut SessionState) {
        use sys::SessionState as S;
        if self.replay().is_some() {
            return;
        }
        let next = match (inner.state, self.presence(inner)) {
            (S::READY, _) => S::SYNCHRONIZED,
            (S::SYNCHRONIZED, Presence::Focused | Presence::Visible) => S::VISIBLE,
            (S::VISIBLE, Presence::Focused) => S::FOCUSED,
            (S::VISIBLE, Presence::Hidden) => S::SYNCHRONIZED,
            (S::FOCUSED, Presence::Visible | Presence::Hidden) => S::VISIBLE,
            _ => return,
        };
        self.enter(inner, next);
    }

    /// The user's attention now: what the motion says, less what the embedding program takes away.
    fn presence(&self, inner: &SessionState) -> Presence {
        if inner.begun_at.is_none() {
            return inner.presence;
        }
        let now = inner.motion_time(self.instance.clock.now());
        inner.presence.min(self.instance.config.motion.presence(now))
    }

    /// The runtime itself asks the application to end.
    pub(crate) fn ask_to_exit(&self, inner: &mut SessionState) {
        inner.exiting = true;
        if inner.running {
            self.stop(inner);
        } else if matches!(
            inner.state,
            // A session that is replayed from a log that ends early has not even become idle.
            sys::SessionState::UNKNOWN | sys::SessionState::READY | sys::SessionState::IDLE
        ) {
            self.enter(inner, sys::SessionState::IDLE);
            self.enter(inner, sys::SessionState::EXITING);
        }
    }

    /// Follows the user: a headset that was taken off stops the session, one that was put on readies it.
    pub(crate) fn poll_presence(&self) {
        let inner = &mut *self.lock();
        if let Some((time, stage_from_local)) = inner.pending_local
            && self.instance.clock.now() >= time
        {
            inner.stage_from_local = stage_from_local;
            inner.pending_local = None;
        }
        if self.replay().is_some() {
            return;
        }
        let recentrings =
            self.instance.config.motion.recentrings(inner.motion_time(self.instance.clock.now()));
        if inner.begun_at.is_some() && recentrings > std::mem::replace(&mut inner.recentrings, recentrings) {
            self.recentre(inner);
        }
        if self.presence(inner) == Presence::Away {
            self.pass_idle_time(inner);
            self.stop(inner);
        } else if inner.state == sys::SessionState::IDLE && !inner.exiting {
            self.enter(inner, sys::SessionState::READY);
        }
    }

    /// Nothing paces a session that stands, so on the virtual clock each question what is new takes as long as a frame: a
    /// motion that takes the headset off can put it on again.
    fn pass_idle_time(&self, inner: &SessionState) {
        let clock = &self.instance.clock;
        let awaits_motion = inner.presence != Presence::Away && inner.state == sys::SessionState::IDLE;
        if awaits_motion && clock.mode() == ClockMode::Virtual {
            clock.sleep_until(clock.now().saturating_add(Profile::period(inner.rate_hz)));
        }
    }

    pub(crate) fn obey(&self, command: Command) {
        let inner = &mut *self.lock();
        match command {
            Command::Exit => self.ask_to_exit(inner),
            Command::LoseSession => {
                inner.lost = true;
                let time = self.instance.clock.now();
                let state = sys::SessionState::LOSS_PENDING;
                self.instance.push_event(Event::StateChanged { session: self.handle, state, time });
                self.frame_begun.notify_all();
            }
            Command::Presence(presence) => inner.presence = presence,
            Command::Recentre => self.recentre(inner),
            Command::HiddenArea(hides) => {
                if std::mem::replace(&mut inner.hides_nothing, !hides) == hides
                    && self.instance.has(Extension::VisibilityMask)
                {
                    self.instance.push_event(Event::VisibilityMaskChanged { session: self.handle });
                }
            }
            Command::LoseInstance => {}
        }
    }

    fn recentre(&self, inner: &mut SessionState) {
        let now = self.instance.clock.now();
        let head = self.instance.config.motion.head(inner.motion_time(now));
        let Some(stage_from_local) = head.pose().map(|head| upright(&head)) else { return };
        // The change comes with the next frame, so that the event is there before it.
        let time = now.saturating_add(Span::from_nanos(1));
        let pose = crate::pose::to_xr(&(inner.stage_from_local.inverse() * stage_from_local));
        inner.pending_local = Some((time, stage_from_local));
        let mut spaces = vec![sys::ReferenceSpaceType::LOCAL];
        if self.instance.has_local_floor() {
            spaces.push(sys::ReferenceSpaceType::LOCAL_FLOOR);
        }
        for space in spaces {
            self.instance.push_event(Event::LocalSpaceChanging { session: self.handle, space, time, pose });
        }
    }

    /// Where the head is at an instant of session time: head coordinates to stage coordinates.
    pub(crate) fn head(&self, at: Timestamp) -> Tracked {
        let at = self.lock().motion_time(at);
        self.instance.config.motion.head(at)
    }
}

impl Instance {
    pub(crate) fn has_local_floor(&self) -> bool {
        self.minor >= 1 || self.has(Extension::LocalFloor)
    }
}

impl SessionState {
    pub(crate) fn is_visible(&self) -> bool {
        matches!(self.state, sys::SessionState::VISIBLE | sys::SessionState::FOCUSED)
    }

    pub(crate) fn is_focused(&self) -> bool {
        self.state == sys::SessionState::FOCUSED
    }

    /// Motion time of an instant of session time. The motion waits for the session to begin.
    pub(crate) fn motion_time(&self, at: Timestamp) -> Timestamp {
        let since = self.begun_at.and_then(|begun| at.since(begun)).unwrap_or(Span::ZERO);
        Timestamp::from_nanos(since.as_nanos())
    }

    /// Where LOCAL is at an instant: a recentring that is pending counts from its time on.
    pub(crate) fn stage_from_local_at(&self, at: Timestamp) -> Rigid {
        match self.pending_local {
            Some((time, stage_from_local)) if at >= time => stage_from_local,
            _ => self.stage_from_local,
        }
    }
}

/// The pose with its pitch and roll taken away: what LOCAL is made from.
fn upright(pose: &Rigid) -> Rigid {
    Rigid::from_parts(pose.translation, yaw_of(pose))
}

pub(crate) fn create_session(
    instance: Arc<Instance>,
    info: In<sys::SessionCreateInfo>,
    mut out: Out<sys::Session>,
) -> XrResult {
    let info = info.get()?;
    out.check()?;
    check_system(info.system_id)?;
    if info.create_flags != sys::SessionCreateFlags::EMPTY {
        return Err(sys::Result::ERROR_VALIDATION_FAILURE);
    }
    let graphics = Graphics::from_chain(&instance, info.next.cast::<c_void>())?;
    let profile: &Profile = &instance.config.profile;
    let stage_from_local = match instance.config.motion.head(Timestamp::default()).pose() {
        Some(head) => upright(&head),
        None => Rigid::translation(0.0, 1.6, 0.0),
    };
    let rate_hz = profile.rates_hz[0];
    // Of two threads that ask at once, one gets the session.
    let mut shared = instance.lock();
    if shared.session.strong_count() > 0 {
        return Err(sys::Result::ERROR_LIMIT_REACHED);
    }
    let (handle, session) = handle::insert(sys::Handle::into_raw(instance.handle), |handle| Session {
        handle,
        instance: instance.clone(),
        graphics,
        state: Mutex::new(SessionState {
            state: sys::SessionState::UNKNOWN,
            running: false,
            exiting: false,
            lost: false,
            presence: Presence::default(),
            hides_nothing: false,
            recentrings: 0,
            begun_at: None,
            frames: Frames::default(),
            rate_hz,
            stage_from_local,
            pending_local: None,
            input: Input::default(),
        }),
        frame_begun: Condvar::new(),
    });
    shared.session = Arc::downgrade(&session);
    drop(shared);
    let inner = &mut *session.lock();
    match session.instance.config.motion.replay() {
        Some(replay) if !replay.is_exhausted() => replay.begin_session(),
        _ => {
            session.enter(inner, sys::SessionState::IDLE);
            session.enter(inner, sys::SessionState::READY);
        }
    }
    out.set(handle)?;
    Ok(sys::Result::SUCCESS)
}

/// A lost session, too, can be destroyed.
pub(crate) fn destroy_session(handle: sys::Session) -> XrResult {
    let session = handle::remove::<Session>(handle)?;
    session.lock().running = false;
    session.frame_begun.notify_all();
    let mut shared = session.instance.lock();
    shared.events.forget(handle);
    shared.session = std::sync::Weak::new();
    drop(shared);
    if let Some(graphics) = &session.graphics {
        graphics.finish();
    }
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn begin_session(session: &Session, info: In<sys::SessionBeginInfo>) -> XrResult {
    let info = info.get()?;
    check_view_configuration(info.primary_view_configuration_type)?;
    let inner = &mut *session.lock();
    if inner.running {
        return Err(sys::Result::ERROR_SESSION_RUNNING);
    }
    if inner.state != sys::SessionState::READY {
        return Err(sys::Result::ERROR_SESSION_NOT_READY);
    }
    inner.running = true;
    inner.begun_at.get_or_insert(session.instance.clock.now());
    inner.frames.restart();
    if session.graphics.is_none() && session.replay().is_none() {
        // Nothing will be synchronized with: a headless session is focused at once (XR_MND_headless).
        for state in [sys::SessionState::SYNCHRONIZED, sys::SessionState::VISIBLE, sys::SessionState::FOCUSED]
        {
            session.enter(inner, state);
        }
    }
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn end_session(session: &Session) -> XrResult {
    let inner = &mut *session.lock();
    if !inner.running {
        return Err(sys::Result::ERROR_SESSION_NOT_RUNNING);
    }
    if inner.state != sys::SessionState::STOPPING {
        return Err(sys::Result::ERROR_SESSION_NOT_STOPPING);
    }
    inner.running = false;
    inner.frames.restart();
    session.frame_begun.notify_all();
    if session.replay().is_some() {
        return Ok(sys::Result::SUCCESS);
    }
    session.enter(inner, sys::SessionState::IDLE);
    if inner.exiting {
        session.enter(inner, sys::SessionState::EXITING);
    }
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn request_exit_session(session: &Session) -> XrResult {
    let inner = &mut *session.lock();
    if !inner.running {
        return Err(sys::Result::ERROR_SESSION_NOT_RUNNING);
    }
    // In a recording, what followed the request is there.
    if session.replay().is_none() {
        session.ask_to_exit(inner);
    }
    Ok(sys::Result::SUCCESS)
}

/// As the specification names it.
fn session_state(name: &str) -> Option<sys::SessionState> {
    use sys::SessionState as S;
    Some(match name {
        "IDLE" => S::IDLE,
        "READY" => S::READY,
        "SYNCHRONIZED" => S::SYNCHRONIZED,
        "VISIBLE" => S::VISIBLE,
        "FOCUSED" => S::FOCUSED,
        "STOPPING" => S::STOPPING,
        "LOSS_PENDING" => S::LOSS_PENDING,
        "EXITING" => S::EXITING,
        _ => return None,
    })
}
