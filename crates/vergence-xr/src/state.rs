//! The states a headset can be in, for the user, and the steps by which OpenXR's session states lead through them.

use openxr::SessionState;

/// What the headset is to the user, now. Whatever happens outside (no loader, no runtime, no headset, headset taken off,
/// session or instance lost) leads to one of these.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum State {
    /// There is no headset and none will come: nothing to wait for.
    Flat,
    /// A loader is there, but no runtime answers or no headset is connected yet: worth trying again.
    WaitingForRuntime,
    /// The session exists and shows nothing: not started yet, or the headset is not worn.
    Idle,
    /// Frames are paced.
    Running {
        /// The user sees them.
        visible: bool,
        /// The user's hands are ours, too.
        focused: bool,
    },
    /// The user or the runtime ended the session: done.
    Exiting,
    /// The runtime took the session or the instance away.
    Lost {
        /// A new one may be asked for.
        retry: bool,
    },
}

impl State {
    /// A sentence for the user.
    pub const fn sentence(self) -> &'static str {
        match self {
            Self::Flat => "there is no headset",
            Self::WaitingForRuntime => "waiting for the headset and its runtime",
            Self::Idle => "nobody wears the headset: put the headset on to go on",
            Self::Running { visible: false, .. } => {
                "the headset shows something else: close what is in front of the scene"
            }
            Self::Running { visible: true, focused: false } => {
                "the scene is visible, but another application has the hands: close its menu"
            }
            Self::Running { visible: true, focused: true } => "the scene is visible and has the input",
            Self::Exiting => "the session has ended",
            Self::Lost { retry: true } => "the runtime lost the session; trying to get it back",
            Self::Lost { retry: false } => "the runtime lost the session for good",
        }
    }

    /// One word for logs and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Flat => "flat",
            Self::WaitingForRuntime => "waiting-for-runtime",
            Self::Idle => "idle",
            Self::Running { visible: false, .. } => "running",
            Self::Running { visible: true, focused: false } => "visible",
            Self::Running { visible: true, focused: true } => "focused",
            Self::Exiting => "exiting",
            Self::Lost { .. } => "lost",
        }
    }

    /// Whether the user sees the scene.
    pub const fn is_visible(self) -> bool {
        matches!(self, Self::Running { visible: true, .. })
    }

    /// Whether the user does not see the scene or has no hands in it, and could change that.
    pub const fn keeps_user_from_scene(self) -> bool {
        matches!(self, Self::Idle | Self::Running { focused: false, .. })
    }

    /// Whether frames are paced (waited for, begun and ended).
    pub const fn is_running(self) -> bool {
        matches!(self, Self::Running { .. })
    }
}

/// What the client must call after a change of the session's state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    /// Nothing.
    Nothing,
    /// xrBeginSession.
    Begin,
    /// xrEndSession.
    End,
}

/// Follows a session through its states. Pure: it calls nothing.
#[derive(Debug)]
pub(crate) struct Lifecycle {
    state: State,
}

impl Lifecycle {
    pub(crate) const fn new() -> Self {
        Self { state: State::Idle }
    }

    pub(crate) const fn state(&self) -> State {
        self.state
    }

    /// The runtime says that the session is in another state. Repeated and misordered events do no harm: a session that
    /// runs is not begun again, one that does not run is not ended.
    pub(crate) fn on_session_state(&mut self, state: SessionState) -> Step {
        if matches!(self.state, State::Lost { .. } | State::Exiting) {
            return Step::Nothing;
        }
        let was_running = self.state.is_running();
        let (next, step) = match state {
            SessionState::IDLE if was_running => (self.state, Step::Nothing),
            SessionState::IDLE | SessionState::UNKNOWN => (State::Idle, Step::Nothing),
            SessionState::READY if was_running => (self.state, Step::Nothing),
            SessionState::READY => (State::Running { visible: false, focused: false }, Step::Begin),
            SessionState::SYNCHRONIZED if was_running => {
                (State::Running { visible: false, focused: false }, Step::Nothing)
            }
            SessionState::VISIBLE if was_running => {
                (State::Running { visible: true, focused: false }, Step::Nothing)
            }
            SessionState::FOCUSED if was_running => {
                (State::Running { visible: true, focused: true }, Step::Nothing)
            }
            SessionState::STOPPING if was_running => (State::Idle, Step::End),
            SessionState::LOSS_PENDING => (State::Lost { retry: true }, Step::Nothing),
            SessionState::EXITING => (State::Exiting, Step::Nothing),
            // Misordered, or of a version that is not known here.
            _ => (self.state, Step::Nothing),
        };
        self.state = next;
        step
    }

    /// A call failed with a loss, or the runtime announced one.
    pub(crate) fn on_loss(&mut self) {
        self.state = State::Lost { retry: true };
    }

    /// The runtime does not answer any more.
    pub(crate) fn on_hang(&mut self) {
        self.state = State::Lost { retry: false };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn play(events: &[SessionState]) -> (State, Vec<Step>) {
        let mut lifecycle = Lifecycle::new();
        let steps = events.iter().map(|&e| lifecycle.on_session_state(e)).filter(|s| *s != Step::Nothing);
        let steps = steps.collect();
        (lifecycle.state(), steps)
    }

    #[test]
    fn a_whole_life() {
        use SessionState as S;
        let up = [S::IDLE, S::READY, S::SYNCHRONIZED, S::VISIBLE, S::FOCUSED];
        assert_eq!(play(&up), (State::Running { visible: true, focused: true }, vec![Step::Begin]));
        let down = [&up[..], &[S::VISIBLE, S::SYNCHRONIZED, S::STOPPING]].concat();
        assert_eq!(play(&down), (State::Idle, vec![Step::Begin, Step::End]));
        let off_and_on = [&down[..], &[S::IDLE], &up[1..]].concat();
        assert_eq!(play(&off_and_on).1, [Step::Begin, Step::End, Step::Begin]);
        let exit = [&down[..], &[S::IDLE, S::EXITING]].concat();
        assert_eq!(play(&exit).0, State::Exiting);
    }

    #[test]
    fn misordered_events_do_no_harm() {
        use SessionState as S;
        assert_eq!(play(&[S::FOCUSED, S::STOPPING]), (State::Idle, vec![]));
        assert_eq!(play(&[S::READY, S::READY]).1, [Step::Begin]);
        assert_eq!(play(&[S::READY, S::from_raw(4711)]).0, State::Running { visible: false, focused: false });
        // What is lost or over stays so.
        assert_eq!(
            play(&[S::READY, S::LOSS_PENDING, S::READY]),
            (State::Lost { retry: true }, vec![Step::Begin])
        );
        assert_eq!(play(&[S::EXITING, S::READY]), (State::Exiting, vec![]));
    }
}
