//! The frame loop: wait, begin, end.

use std::time::Duration;

use openxr_sys as sys;
use vergence_time::{Span, Timestamp};

use crate::clock::valid_time;
use crate::config::ClockMode;
use crate::fault::bent_time;
use crate::ffi::{In, Out, XrResult};
use crate::headset::Profile;
use crate::layer::{self, Layer};
use crate::motion::Replay;
use crate::session::{Session, SessionState};

/// How long `xrWaitFrame` waits for another thread to begin the frame before, by the host's clock, until it gives up.
const LONGEST_WAIT: Duration = Duration::from_secs(10);

/// Where the frame loop is.
#[derive(Default)]
pub(crate) struct Frames {
    /// A thread is in `xrWaitFrame`.
    waiting: bool,
    /// Waited for, not begun.
    waited: Option<Frame>,
    /// Begun, not ended.
    begun: Option<Frame>,
    /// When the frame that was begun last is displayed: the instant whose input the application gets.
    pub(crate) input_time: Option<Timestamp>,
    /// When the last frame was predicted to be displayed.
    last_display: Option<Timestamp>,
    /// Frames that were ended after `shouldRender`.
    rendered: u64,
    /// Frames that were composed.
    composed: u64,
}

#[derive(Clone, Copy)]
struct Frame {
    display: Timestamp,
    should_render: bool,
}

impl Frames {
    /// Forgets frames under way; time goes on.
    pub(crate) fn restart(&mut self) {
        (self.waiting, self.waited, self.begun) = (false, None, None);
    }
}

fn check_running(inner: &SessionState) -> XrResult<()> {
    if inner.running { Ok(()) } else { Err(sys::Result::ERROR_SESSION_NOT_RUNNING) }
}

/// When the next frame is displayed and when the application may start on it: one period before.
fn predict(session: &Session, inner: &SessionState) -> (Timestamp, Span) {
    let period = Profile::period(inner.rate_hz);
    let now = session.instance.clock.now();
    let next = inner.frames.last_display.unwrap_or(now).saturating_add(period);
    if session.instance.clock.mode() == ClockMode::Virtual {
        // Later only where time passed between two runs of the session.
        return (next.max(now.saturating_add(period)), period);
    }
    // Late: the first display instant that is still to come, be it sooner than a whole period from now.
    let late = now.saturating_add(period).since(next).map_or(0, Span::as_nanos);
    let skipped = if late > 0 { late.div_euclid(period.as_nanos()) } else { 0 };
    (next.saturating_add(period.checked_mul(skipped).unwrap_or(Span::ZERO)), period)
}

pub(crate) fn wait_frame(
    session: &Session,
    info: In<sys::FrameWaitInfo>,
    mut out: Out<sys::FrameState>,
) -> XrResult {
    info.optional()?;
    out.fill()?;
    session.instance.attend();
    session.check_lost()?;
    let mut inner = session.lock();
    check_running(&inner)?;
    while inner.running && !inner.lost && (inner.frames.waiting || inner.frames.waited.is_some()) {
        let (guard, timeout) = session
            .frame_begun
            .wait_timeout(inner, LONGEST_WAIT)
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        inner = guard;
        if timeout.timed_out() {
            log::error!("xrWaitFrame: no thread began the frame before within {LONGEST_WAIT:?}");
            return Err(sys::Result::ERROR_RUNTIME_FAILURE);
        }
    }
    if inner.lost {
        return Err(sys::Result::ERROR_SESSION_LOST);
    }
    check_running(&inner)?;
    inner.frames.waiting = true;
    drop(inner);
    let replay = session.replay();
    let said = replay.and_then(Replay::wait);
    if let Some(replay) = replay.filter(|_| said.is_none()) {
        session.lock().frames.waiting = false;
        session.leave_replay(replay)?;
    }
    let mut inner = session.lock();
    let (display, period) = said.map_or_else(|| predict(session, &inner), |said| (said.display, said.period));
    inner.frames.last_display = Some(display);
    drop(inner);
    let wake = display.saturating_add(Span::from_nanos(-period.as_nanos()));
    session.instance.clock.sleep_until(said.map_or(wake, |said| said.now));

    let mut inner = session.lock();
    let config = &session.instance.config;
    let asks = match said {
        Some(said) => said.should_render,
        None => inner.is_visible() && config.motion.renders(inner.motion_time(display)),
    };
    let should_render = asks && config.render && session.graphics.is_some();
    inner.frames.waiting = false;
    inner.frames.waited = Some(Frame { display, should_render });
    check_running(&inner)?;
    drop(inner);
    let (display, period) = bent_time(display, period);
    let state = out.fill()?;
    state.predicted_display_time = sys::Time::from_nanos(display.as_nanos());
    state.predicted_display_period = sys::Duration::from_nanos(period.as_nanos());
    state.should_render = should_render.into();
    Ok(sys::Result::SUCCESS)
}

pub(crate) fn begin_frame(session: &Session, info: In<sys::FrameBeginInfo>) -> XrResult {
    info.optional()?;
    let inner = &mut *session.lock();
    check_running(inner)?;
    let frame = inner.frames.waited.take().ok_or(sys::Result::ERROR_CALL_ORDER_INVALID)?;
    session.frame_begun.notify_all();
    inner.frames.input_time = Some(frame.display);
    let discarded = inner.frames.begun.replace(frame).is_some();
    Ok(if discarded { sys::Result::FRAME_DISCARDED } else { sys::Result::SUCCESS })
}

pub(crate) fn end_frame(session: &Session, info: In<sys::FrameEndInfo>) -> XrResult {
    let info = info.get()?;
    check_running(&session.lock())?;
    if session.lock().frames.begun.is_none() {
        return Err(sys::Result::ERROR_CALL_ORDER_INVALID);
    }
    let display = valid_time(info.display_time)?;
    layer::check_blend_mode(info.environment_blend_mode)?;
    let layers = layer::read(session, info)?;
    let (frame, number) = {
        let inner = &mut *session.lock();
        let frame = inner.frames.begun.take().ok_or(sys::Result::ERROR_CALL_ORDER_INVALID)?;
        let number = inner.frames.composed;
        if frame.should_render {
            inner.frames.composed += 1;
        }
        (frame, number)
    };
    if frame.should_render {
        compose(session, number, display, &layers)?;
    }
    let inner = &mut *session.lock();
    inner.frames.rendered += u64::from(frame.should_render);
    let enough = session.instance.config.frames.is_some_and(|frames| inner.frames.rendered >= frames);
    let over = session.instance.config.motion.end().is_some_and(|end| inner.motion_time(display) > end);
    if enough || over {
        session.ask_to_exit(inner);
    } else {
        session.step(inner);
    }
    Ok(sys::Result::SUCCESS)
}

/// Makes the picture that the user sees and gives it to whoever wants it; nothing happens where nobody does.
fn compose(session: &Session, number: u64, display: Timestamp, layers: &[Layer]) -> XrResult<()> {
    let (Some(capture), Some(graphics)) = (&session.instance.config.capture, &session.graphics) else {
        return Ok(());
    };
    let frame = graphics.compose(session, number, display, layers)?;
    capture.give(frame);
    Ok(())
}
