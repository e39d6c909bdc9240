//! A session: its states, spaces, images, input, and the frame loop's calls in their order.
//!
//! Length: one type whose calls share its fields; each call is heard by a tap where it is made.

use std::sync::Arc;
use std::time::Duration;

use openxr::sys;
use vergence_action::ActionSet;
use vergence_geom::Rigid;
use vergence_gpu::{Device, ImageView};
use vergence_sense::{Body, Event, Gaze, Hand, HandJoints, Haptic, Pose, Said};
use vergence_stream::PoseHistory;
use vergence_time::{Span, Timestamp};

use crate::connection::Connection;
use crate::convert;
use crate::error::{Error, In};
use crate::event::{self, Notice, Notices};
use crate::hands::Hands;
use crate::hidden_area::{HiddenArea, hidden_area};
use crate::input::{Input, Reading};
use crate::list::list;
use crate::located::{Located, Viewpoints};
use crate::opening::{Pictures, REFRESH_RATE, choose_pictures, choose_refresh_rate, create_session};
use crate::runtime_clock::RuntimeClock;
use crate::state::{Lifecycle, State, Step};
use crate::swapchain::{Swapchain, SwapchainDesc};
use crate::tap::{Call, Ear, Tap, raw_location, raw_views};
use crate::time_guard::{Prediction, TimeGuard};
use crate::waiter::Waiter;

/// What a session shall be.
#[derive(Clone, Copy, Debug)]
pub struct SessionDesc<'a> {
    /// Distance of the near plane, metres, for the depth layer (reversed depth, no far plane).
    pub near_m: f64,
    /// Size of the pictures as a factor of the recommended one; 1 matches the display. Cost grows with its square.
    pub render_scale: f64,
    /// What the user can do; nothing is created where it is empty.
    pub actions: &'a ActionSet,
    /// Whether the joints of the hands are read.
    pub hand_joints: bool,
    /// Whether the gaze is read.
    pub eye_gaze: bool,
    /// The display's rate, which must be one that it has; `None`: as it is.
    pub refresh_rate_hz: Option<f32>,
    /// How long `xrWaitFrame` may take until the runtime is taken for hung. Default 10 s.
    pub wait_patience: Duration,
    /// What is done without although the runtime may have it.
    pub without: Without,
}

/// What a runtime need not have. A recorded session whose runtime had none of it is lived through again without it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Without {
    /// The runtime's own clock is not read.
    pub clock: bool,
    /// The floor is not looked for.
    pub floor: bool,
}

/// What an earlier session went by in a frame for which the runtime's clock could not be read: the time that passed was the
/// host's then.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TakenTimes {
    /// When the frame was taken to be shown, on the runtime's clock.
    pub display: Timestamp,
    /// The time between frames.
    pub period: Span,
    /// The runtime's own times were not believed.
    pub is_faulty: bool,
    /// The runtime was believed anew.
    pub rebased: bool,
}

/// A runtime that paces frames answers within a second, one that is busy with itself within a few.
const WAIT_PATIENCE: Duration = Duration::from_secs(10);

impl<'a> SessionDesc<'a> {
    /// The defaults: near plane at 5 cm, the recommended size, no further streams, the display's rate as it is.
    pub const fn new(actions: &'a ActionSet) -> Self {
        Self {
            near_m: 0.05,
            render_scale: 1.0,
            actions,
            hand_joints: false,
            eye_gaze: false,
            refresh_rate_hz: None,
            wait_patience: WAIT_PATIENCE,
            without: Without { clock: false, floor: false },
        }
    }
}

/// A frame that has been waited for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// When it will be shown.
    pub prediction: Prediction,
    /// Whether anybody will see it; else nothing need be drawn.
    pub should_render: bool,
}

/// Where to draw a frame; one layer per view.
#[derive(Clone)]
pub struct Attachments {
    /// sRGB.
    pub color: Arc<ImageView>,
    /// Reversed depth, where it is submitted.
    pub depth: Option<Arc<ImageView>>,
}

/// A session on a headset.
///
/// The renderer must have finished with all [`Attachments`] before the client is dropped (the device is waited for, but
/// views kept elsewhere would outlive their images).
pub struct Client {
    lifecycle: Lifecycle,
    notices: Notices,
    guard: TimeGuard,
    reported_fault: bool,
    reported_nonsense: bool,
    reported_loss_pending: bool,
    clock: RuntimeClock,
    host: vergence_time::HostClock,
    viewpoints: Viewpoints,
    pictures: Pictures,
    near_m: f64,
    reads_clock: bool,
    taken_times: Option<Box<dyn FnMut() -> Option<TakenTimes> + Send>>,
    /// Waited for, not begun: a frame that could not be begun is not waited for again.
    waited: Option<Frame>,
    /// Begun, not ended.
    begun: Option<Frame>,
    /// The latest instant that is known to have been.
    latest: Option<Timestamp>,
    ear: Ear,
    /// Boxed once: an event is 4 KB.
    events: Box<openxr::EventDataBuffer>,
    // What lives on the session, then the session, then what it was made from: fields are dropped in this order.
    input: Option<Input>,
    joints: Option<Hands>,
    color: Swapchain,
    depth: Option<Swapchain>,
    head: openxr::Space,
    floor: Option<openxr::Space>,
    local: openxr::Space,
    waiter: Waiter,
    session: openxr::Session<openxr::Vulkan>,
    device: Arc<Device>,
    connection: Arc<Connection>,
}

impl Client {
    /// Starts a session on a device that the connection's [`Creator`](crate::Creator) made.
    ///
    /// # Errors
    /// Where the runtime refuses, or offers no format that can be drawn into.
    pub fn new(
        connection: &Arc<Connection>,
        device: &Arc<Device>,
        desc: &SessionDesc<'_>,
    ) -> Result<Self, Error> {
        let (session, waiter) = create_session(connection, device)?;
        let pictures = choose_pictures(connection, &session, device, desc)?;
        let swapchain = |name, format, is_depth| {
            let Pictures { size, views: layers, .. } = pictures;
            Swapchain::new(&session, device, &SwapchainDesc { name, format, size, layers, is_depth })
        };
        let color = swapchain("openxr colour", pictures.color_format, false)?;
        let depth =
            pictures.depth_format.map(|format| swapchain("openxr depth", format, true)).transpose()?;

        let space =
            |kind| session.create_reference_space(kind, convert::IDENTITY).during("xrCreateReferenceSpace");
        let enumerate = session.instance().fp().enumerate_reference_spaces;
        let none = openxr::ReferenceSpaceType::from_raw(0);
        let offered = list("xrEnumerateReferenceSpaces", none, |capacity, count, items| {
            // SAFETY: the session lives; `items` is null or has `capacity` elements.
            unsafe { enumerate(session.as_raw(), capacity, count, items) }
        })?;
        let floor_kinds = [openxr::ReferenceSpaceType::LOCAL_FLOOR, openxr::ReferenceSpaceType::STAGE];
        let floor_kind = floor_kinds.into_iter().filter(|_| !desc.without.floor).find(|&kind| {
            let may_ask = kind != openxr::ReferenceSpaceType::LOCAL_FLOOR
                || connection.has("XR_EXT_local_floor")
                || connection.description().api == "1.1";
            may_ask && offered.contains(&kind)
        });
        let input = Input::new(connection, &session, desc.actions, desc.eye_gaze)?;
        let joints = if desc.hand_joints { Hands::new(connection, &session)? } else { None };
        choose_refresh_rate(connection, &session, desc.refresh_rate_hz)?;
        Ok(Self {
            lifecycle: Lifecycle::new(),
            notices: Notices::default(),
            guard: TimeGuard::default(),
            reported_fault: false,
            reported_nonsense: false,
            reported_loss_pending: false,
            clock: RuntimeClock::default(),
            host: vergence_time::HostClock::start(),
            viewpoints: Viewpoints::new(pictures.views),
            pictures,
            near_m: desc.near_m,
            reads_clock: connection.has_clock() && !desc.without.clock,
            taken_times: None,
            waited: None,
            begun: None,
            latest: None,
            ear: Ear::default(),
            events: Box::new(openxr::EventDataBuffer::new()),
            input,
            joints,
            color,
            depth,
            head: space(openxr::ReferenceSpaceType::VIEW)?,
            floor: floor_kind.map(space).transpose()?,
            local: space(openxr::ReferenceSpaceType::LOCAL)?,
            waiter: Waiter::start(waiter, desc.wait_patience)?,
            session,
            device: Arc::clone(device),
            connection: Arc::clone(connection),
        })
    }

    /// What the pictures are like.
    pub const fn pictures(&self) -> Pictures {
        self.pictures
    }

    /// The state now.
    pub const fn state(&self) -> State {
        self.lifecycle.state()
    }

    /// CPU time that this thread has spent inside the runtime so far (time that it spent inside Vulkan there not
    /// counted: the graphics device counts that).
    pub fn runtime_cpu(&self) -> Span {
        self.clock.spent()
    }

    /// The runtime's clock, where it can be asked.
    pub fn now(&self) -> Option<Timestamp> {
        self.connection.now()?.ok()
    }

    /// The latest instant of session time that is known to have been; `None` before the first frame.
    pub const fn latest(&self) -> Option<Timestamp> {
        self.latest
    }

    /// The driver of the device that draws, with its version.
    pub fn driver(&self) -> &str {
        &self.device.limits().driver
    }

    /// What this session does without.
    pub fn without(&self) -> Without {
        Without { clock: !self.reads_clock, floor: self.floor.is_none() }
    }

    /// From now on frames for which the runtime's clock cannot be read go by what `times` says of the frame that was waited for.
    pub fn go_by(&mut self, times: impl FnMut() -> Option<TakenTimes> + Send + 'static) {
        self.taken_times = Some(Box::new(times));
    }

    /// From now on, where the runtime does not know where the eyes are, `history` is asked: it is given each pose of the first
    /// eye that the runtime does know, at the time that it is for.
    pub fn foretell(&mut self, history: PoseHistory) {
        self.viewpoints.foretell(history);
    }

    /// What the eyes did so far says nothing about what comes: the origin has moved, or time has.
    pub fn forget_motion(&mut self) {
        self.viewpoints.forget_motion();
    }

    /// From now on `tap` hears what every call of this session says.
    pub fn set_tap(&mut self, tap: Box<dyn Tap>) {
        self.ear = Ear::of(tap);
    }

    /// The tap that hears, where there is one.
    pub fn tap_mut(&mut self) -> Option<&mut dyn Tap> {
        self.ear.tap.as_deref_mut()
    }

    /// The tap back, which hears no more.
    pub fn take_tap(&mut self) -> Option<Box<dyn Tap>> {
        self.ear.tap.take()
    }

    /// Lets the tap hear something that belongs between the calls, where there is a tap.
    pub fn tell(&mut self, said: impl FnOnce() -> Said) {
        self.ear.hear(said);
    }

    /// Follows the runtime's events and says what has happened, oldest first. Call before every frame, and now and then
    /// while no frames are paced.
    ///
    /// # Errors
    /// Where the runtime refuses; losses are states, too.
    pub fn poll(&mut self) -> Result<State, Error> {
        let result = self.poll_events();
        if self.ear.loss_is_pending() && !std::mem::replace(&mut self.reported_loss_pending, true) {
            self.notices.push(Notice::LossPending);
        }
        self.note(result)?;
        Ok(self.state())
    }

    fn poll_events(&mut self) -> Result<(), Error> {
        // A runtime that never stops sending events is not followed for ever.
        for _ in 0..1000 {
            let Self { clock, session, events, ear, .. } = self;
            let polled = clock.during(|| session.instance().poll_event(events));
            let before = self.lifecycle.state();
            let Some(event) = ear.answer(Call::PollEvent, polled)? else { break };
            if let Some(said) = event::said(&event, &self.session) {
                ear.hear(|| Said::Event(said));
            }
            let step = self.notices.take(&event, &mut self.lifecycle, &self.session);
            match step {
                Step::Nothing => {}
                Step::Begin => {
                    let kind = self.connection.view_configuration;
                    let Self { clock, session, ear, .. } = self;
                    let begun = clock.during(|| session.begin(kind));
                    let begun = ear.answer(Call::BeginSession, begun);
                    self.settle(begun)?;
                }
                Step::End => {
                    (self.waited, self.begun) = (None, None);
                    self.ear.abandon_frame();
                    let Self { clock, session, ear, .. } = self;
                    let ended = clock.during(|| session.end());
                    let ended = ear.answer(Call::EndSession, ended);
                    self.settle(ended)?;
                }
            }
            let after = self.lifecycle.state();
            if after != before {
                self.notices.push(Notice::State(after));
            }
        }
        Ok(())
    }

    /// A session that could not be begun or ended is of no use any more: the runtime asks for it only once.
    fn settle<T>(&mut self, result: Result<T, Error>) -> Result<T, Error> {
        if result.is_err() {
            self.on_loss();
        }
        result
    }

    /// What has happened since the last call, oldest first. Of more than 256, only recentrings and changes of what is hidden
    /// are kept, and the others counted.
    pub fn drain_notices(&mut self) -> impl Iterator<Item = Notice> + '_ {
        self.notices.drain()
    }

    /// How many notices were left out since the last call of this, because those before them had not been asked for.
    pub fn take_notices_left_out(&mut self) -> u64 {
        self.notices.take_left_out()
    }

    /// Asks the runtime to end the session: states then lead to [`State::Exiting`]. Nothing happens where no frames are
    /// paced: such a session is simply dropped.
    ///
    /// # Errors
    /// Where the runtime refuses.
    pub fn request_exit(&mut self) -> Result<(), Error> {
        if !self.state().is_running() {
            return Ok(());
        }
        let Self { clock, session, ear, .. } = self;
        ear.hear(|| Said::Event(Event::new("exit_requested", "")));
        let asked = clock.during(|| session.request_exit());
        let result = ear.answer(Call::RequestExitSession, asked);
        self.note(result)
    }

    /// Waits until the next frame should be begun. May block for as long as the runtime likes, up to
    /// [`SessionDesc::wait_patience`]. A frame that was waited for and could not be begun is given again.
    ///
    /// # Errors
    /// A loss, a call while no frames are paced, or [`Error::Hung`].
    pub fn wait(&mut self) -> Result<Frame, Error> {
        if let Some(frame) = self.waited {
            return Ok(frame);
        }
        // On a thread of its own: its time is not this thread's.
        let waited = self.waiter.wait().and_then(|answer| self.ear.answer(Call::WaitFrame, answer));
        let state = self.note(waited)?;
        self.ear.next_frame();
        let clock_said = if self.reads_clock { self.clock.during(|| self.connection.now()) } else { None };
        let runtime_now = clock_said.and_then(Result::ok);
        let raw_display = Timestamp::from_nanos(state.predicted_display_time.as_nanos());
        let raw_period = Span::from_nanos(state.predicted_display_period.as_nanos());
        let host_now = vergence_time::Clock::now(&self.host);
        let mut prediction = self.guard.check(raw_display, raw_period, host_now, runtime_now);
        if runtime_now.is_none()
            && let Some(taken) = self.taken_times.as_mut().and_then(|times| times())
        {
            prediction = self.guard.take(prediction, &taken, raw_display);
        }
        if let Some(fault) = prediction.fault
            && !self.reported_fault
        {
            self.notices.push(Notice::Time(fault));
        }
        self.reported_fault = prediction.fault.is_some();
        if prediction.fault.is_some() || prediction.rebased {
            let at = Some(raw_display);
            let name = if prediction.rebased { "time_rebased" } else { "time_fault" };
            self.ear.hear(|| Said::Event(Event { at, ..Event::new(name, "") }));
        }
        let early = Span::from_nanos(prediction.period.as_nanos().saturating_neg());
        let now = runtime_now.unwrap_or(prediction.display.saturating_add(early));
        self.latest = self.latest.max(Some(now));
        self.ear.hear(|| Said::Frame {
            now,
            display: prediction.display,
            period: prediction.period,
            should_render: state.should_render,
            raw_display,
            raw_period,
        });
        if let Some(said) = clock_said {
            // A clock that cannot be read now is none; that it could not be is heard all the same.
            let _ = self.ear.answer(Call::ConvertTimespecTimeToTime, said);
        }
        let frame = Frame { prediction, should_render: state.should_render };
        self.waited = Some(frame);
        Ok(frame)
    }

    /// Begins the frame that was waited for.
    ///
    /// # Errors
    /// A loss, or a call out of order.
    pub fn begin(&mut self) -> Result<(), Error> {
        let Self { clock, session, ear, .. } = self;
        // SAFETY: the session lives; a null begin info is allowed.
        let result = clock
            .during(|| unsafe { (session.instance().fp().begin_frame)(session.as_raw(), std::ptr::null()) });
        let begun = ear.check(Call::BeginFrame, result);
        let result = self.note(begun)?;
        if result == sys::Result::FRAME_DISCARDED {
            self.notices.push(Notice::FrameDiscarded);
        }
        self.begun = self.waited.take();
        Ok(())
    }

    /// Where the eyes are at the instant `time`, in LOCAL space. `None` where the runtime does not know and never did:
    /// then nothing can be drawn. Where it has lost them, what is [foretold](Self::foretell) or the last known poses, marked so.
    ///
    /// # Errors
    /// A loss.
    pub fn locate(&mut self, time: Timestamp) -> Result<Option<Located>, Error> {
        let Self { clock, session, connection, viewpoints, local, ear, .. } = self;
        let located =
            clock.during(|| viewpoints.locate(session, connection.view_configuration, local, time, ear));
        let is_nonsense = !self.viewpoints.makes_sense();
        if is_nonsense && !std::mem::replace(&mut self.reported_nonsense, is_nonsense) {
            self.notices.push(Notice::Nonsense);
        }
        self.reported_nonsense = is_nonsense;
        self.note(located)
    }

    /// Where the head is at the instant `time`, in LOCAL space.
    ///
    /// # Errors
    /// A loss.
    pub fn locate_head(&mut self, time: Timestamp) -> Result<Pose, Error> {
        let Self { clock, head, local, ear, .. } = self;
        let at = openxr::Time::from_nanos(time.as_nanos());
        let located = ear.answer(Call::LocateSpace, clock.during(|| head.locate(local, at)));
        let located = self.note(located)?;
        self.ear.hear(|| Said::Place {
            of: Body::Head,
            at: time,
            location: raw_location(located.location_flags, &located.pose),
        });
        Ok(convert::pose(located.location_flags, &located.pose))
    }

    /// Where the floor's origin is in LOCAL space at the instant `time`: upright, below LOCAL's origin. `None` where the
    /// runtime knows no floor, or not yet.
    ///
    /// # Errors
    /// A loss.
    pub fn local_from_floor(&mut self, time: Timestamp) -> Result<Option<Rigid>, Error> {
        let Self { clock, floor: Some(floor), local, ear, .. } = self else { return Ok(None) };
        let at = openxr::Time::from_nanos(time.as_nanos());
        let located = ear.answer(Call::LocateSpace, clock.during(|| floor.locate(local, at)));
        let located = self.note(located)?;
        self.ear.hear(|| Said::Place {
            of: Body::Floor,
            at: time,
            location: raw_location(located.location_flags, &located.pose),
        });
        let floor = convert::pose(located.location_flags, &located.pose).reference_from_device();
        // Only its height: STAGE may lie and turn anywhere in the room.
        Ok(floor.map(|local_from_floor| Rigid::translation(0.0, local_from_floor.translation.y, 0.0)))
    }

    /// Images to draw the frame into. `None` where the compositor keeps them for longer than two seconds: such a frame is
    /// ended without a picture, and the next one asks for the same images.
    ///
    /// # Errors
    /// A loss.
    pub fn acquire(&mut self) -> Result<Option<Attachments>, Error> {
        let acquired = self.acquire_both();
        self.note(acquired)
    }

    fn acquire_both(&mut self) -> Result<Option<Attachments>, Error> {
        let Self { clock, color, depth, ear, .. } = self;
        clock.during(|| {
            let Some(color) = color.acquire(ear)?.map(Arc::clone) else { return Ok(None) };
            let depth = match depth {
                None => None,
                Some(depth) => match depth.acquire(ear)? {
                    None => return Ok(None),
                    Some(depth) => Some(Arc::clone(depth)),
                },
            };
            Ok(Some(Attachments { color, depth }))
        })
    }

    /// Reads actions, hand joints and gaze for the instant `time`.
    ///
    /// # Errors
    /// A loss.
    pub fn sync_input(&mut self, time: Timestamp) -> Result<(), Error> {
        let Self { clock, session, local, input, joints, ear, .. } = self;
        let synced = clock.during(|| {
            if let Some(input) = input {
                input.sync(session, local, time, ear)?;
            }
            joints.as_mut().map_or(Ok(()), |joints| joints.locate(local, time, ear))
        });
        self.note(synced)
    }

    /// Ends the frame. `shown` is what the pictures were drawn with, and is what the runtime is told, bit for bit; `None`
    /// where nothing was drawn.
    ///
    /// # Errors
    /// A loss, or a call out of order.
    pub fn end(&mut self, frame: &Frame, shown: Option<&Located>) -> Result<(), Error> {
        let ended = self.release_and_end(frame, shown);
        self.note(ended)
    }

    /// Ends a frame that was begun, without a picture, where something in between failed.
    ///
    /// # Errors
    /// As [`Self::end`].
    pub fn drop_frame(&mut self) -> Result<(), Error> {
        self.begun.map_or(Ok(()), |frame| self.end(&frame, None))
    }

    /// Lets go of a session whose runtime [hangs](Error::Hung): nothing of it is destroyed, since a call into that runtime
    /// may not return either. What was drawn is waited for.
    pub fn abandon(self) {
        if let Err(error) = self.device.wait_idle() {
            log::warn!("{error}");
        }
        std::mem::forget(self);
    }

    /// Whether the runtime hangs: then [`Self::abandon`] is the way out.
    pub const fn is_hung(&self) -> bool {
        self.waiter.is_hung()
    }

    fn release_and_end(&mut self, frame: &Frame, shown: Option<&Located>) -> Result<(), Error> {
        let Self { clock, session, color, depth, local, pictures, near_m, ear, begun, .. } = self;
        if begun.is_none() {
            // The session ended in between: there is no frame to end.
            return Ok(());
        }
        let near_z = *near_m as f32;
        clock.during(|| {
            if shown.is_some() {
                // What is not released is not shown: the frame stays begun, and is ended without it.
                color.release(ear)?;
                depth.as_mut().map_or(Ok(()), |depth| depth.release(ear))?;
            }
            // From here on it is with the runtime, whatever that answers.
            *begun = None;
            ear.hear(|| Said::Submitted {
                display: frame.prediction.display,
                views: shown.map(|shown| {
                    let views = (0..shown.views().len()).map(|view| shown.raw(view));
                    raw_views(openxr::ViewStateFlags::EMPTY, views)
                }),
            });
            let Pictures { size, views, .. } = *pictures;
            let depth_info = std::array::from_fn::<_, { Located::MOST_VIEWS }, _>(|view| {
                depth.as_ref().map(|depth| sys::CompositionLayerDepthInfoKHR {
                    ty: sys::CompositionLayerDepthInfoKHR::TYPE,
                    next: std::ptr::null(),
                    sub_image: depth.sub_image(view as u32, size),
                    min_depth: 0.0,
                    max_depth: 1.0,
                    // Depth 0 is at infinity, depth 1 at the near plane.
                    near_z: f32::INFINITY,
                    far_z: near_z,
                })
            });
            let projection_views = std::array::from_fn::<_, { Located::MOST_VIEWS }, _>(|view| {
                let (pose, fov) = shown.map_or((convert::IDENTITY, openxr::Fovf::default()), |s| s.raw(view));
                sys::CompositionLayerProjectionView {
                    ty: sys::CompositionLayerProjectionView::TYPE,
                    next: depth_info[view]
                        .as_ref()
                        .map_or(std::ptr::null(), |d| std::ptr::from_ref(d).cast()),
                    pose,
                    fov,
                    sub_image: color.sub_image(view as u32, size),
                }
            });
            let projection = sys::CompositionLayerProjection {
                ty: sys::CompositionLayerProjection::TYPE,
                next: std::ptr::null(),
                layer_flags: openxr::CompositionLayerFlags::EMPTY,
                space: local.as_raw(),
                view_count: views,
                views: projection_views.as_ptr(),
            };
            let layers = [std::ptr::from_ref(&projection).cast::<sys::CompositionLayerBaseHeader>()];
            let info = sys::FrameEndInfo {
                ty: sys::FrameEndInfo::TYPE,
                next: std::ptr::null(),
                display_time: openxr::Time::from_nanos(frame.prediction.display.as_nanos()),
                environment_blend_mode: self.connection.blend_mode,
                layer_count: u32::from(shown.is_some()),
                layers: layers.as_ptr(),
            };
            // SAFETY: everything that the info points to lives in this scope; the frame has been begun.
            let result = unsafe { (session.instance().fp().end_frame)(session.as_raw(), &info) };
            ear.check(Call::EndFrame, result).map(|_| ())
        })
    }

    /// What the eyes never see, one per view; empty where the runtime does not say.
    ///
    /// # Errors
    /// A loss.
    pub fn hidden_areas(&mut self) -> Result<Vec<HiddenArea>, Error> {
        let Self { session, connection, pictures, .. } = self;
        if !connection.has("XR_KHR_visibility_mask") {
            return Ok(Vec::new());
        }
        let area = |view| {
            match hidden_area(connection, session, view) {
                // Pixels that nobody sees cost time, not more.
                Err(error @ Error::Call { .. }) => {
                    log::warn!("{error}: going on without the visibility mask of view {view}");
                    Ok(HiddenArea::default())
                }
                found => found,
            }
        };
        (0..pictures.views).map(area).collect()
    }

    /// The place of an action in the plan's set; `None` where it is not in it.
    pub fn action(&self, name: &str) -> Option<usize> {
        self.input.as_ref()?.index(name)
    }

    /// What an action reads, as of the last [`Self::sync_input`].
    pub fn reading(&self, action: usize, hand: Hand) -> Option<Reading> {
        self.input.as_ref()?.reading(action, hand)
    }

    /// Where the user looks, in LOCAL space, as of the last [`Self::sync_input`].
    pub fn gaze(&self) -> Option<Gaze> {
        self.input.as_ref()?.gaze()
    }

    /// When that gaze was measured, on the runtime's clock; `None` where the runtime does not say it. May be to come, where the
    /// runtime predicts.
    pub fn gaze_sampled(&self) -> Option<Timestamp> {
        self.input.as_ref()?.gaze_sampled()
    }

    /// The joints of a hand in LOCAL space, as of the last [`Self::sync_input`].
    pub fn hand_joints(&self, hand: Hand) -> Option<&HandJoints> {
        self.joints.as_ref()?.joints(hand)
    }

    /// Lets a hand feel a pulse.
    ///
    /// # Errors
    /// A loss.
    pub fn pulse(&mut self, action: usize, hand: Hand, haptic: &Haptic) -> Result<(), Error> {
        let Self { clock, session, input, ear, .. } = self;
        let Some(input) = input else { return Ok(()) };
        ear.hear(|| Said::Haptic { action: action as u16, hand, haptic: *haptic });
        let pulsed = clock.during(|| input.pulse(session, action, hand, haptic, ear));
        self.note(pulsed)
    }

    /// Which device a hand holds now, for people.
    pub fn device_in(&self, hand: Hand) -> Option<String> {
        self.input.as_ref()?.device(&self.session, hand)
    }

    /// Names of the devices whose suggestions the runtime took.
    pub fn accepted_profiles(&self) -> &[&'static str] {
        self.input.as_ref().map_or(&[], Input::accepted_profiles)
    }

    /// Whether the runtime gives the joints of the hands.
    pub const fn reads_hand_joints(&self) -> bool {
        self.joints.is_some()
    }

    /// Whether the runtime gives the gaze.
    pub fn reads_gaze(&self) -> bool {
        self.input.as_ref().is_some_and(Input::reads_gaze)
    }

    /// Whether actions were created at all.
    pub const fn has_actions(&self) -> bool {
        self.input.is_some()
    }

    /// The display's rate, where the runtime says it.
    pub fn refresh_rate_hz(&self) -> Option<f32> {
        if !self.connection.has(REFRESH_RATE) {
            return None;
        }
        self.session.get_display_refresh_rate().ok().filter(|hz| *hz > 0.0)
    }

    /// Turns a failure that is a loss into the state as well.
    fn note<T>(&mut self, result: Result<T, Error>) -> Result<T, Error> {
        match &result {
            Err(Error::SessionLost { .. } | Error::InstanceLost { .. }) => self.on_loss(),
            Err(Error::Hung { .. }) => self.lifecycle.on_hang(),
            _ => {}
        }
        result
    }

    fn on_loss(&mut self) {
        if !matches!(self.lifecycle.state(), State::Lost { .. }) {
            self.lifecycle.on_loss();
            self.notices.push(Notice::State(self.lifecycle.state()));
        }
        (self.waited, self.begun) = (None, None);
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        // The runtime's images must not be destroyed while the GPU draws into them. A lost device has nothing to finish.
        if let Err(error) = self.device.wait_idle() {
            log::warn!("{error}");
        }
    }
}
