//! One session: device, client, renderer, and the loop wait, begin, locate, cull, record, locate again, latch, submit, end.

use std::sync::Arc;
use std::time::{Duration, Instant};

use vergence_geom::{Rigid, View};
use vergence_gpu as gpu;
use vergence_render::{Attachments, Renderer, Target};
use vergence_sense::{Event, Hand, Said};
use vergence_time::{Span, Timestamp};
use vergence_xr::{Client, Frame, Located, Notice, SessionDesc, State, TakenTimes, Without, in_world};
use vergence_xr_sim::motion::{EXIT_REQUESTED, SESSION_BEGINS};

use crate::book::{self, Book};
use crate::capture::Picture;
use crate::desk::Desk;
use crate::error::{Error, with_cause};
use crate::foresight;
use crate::guest::{self, Offered, Stage};
use crate::headset::Chosen;
use crate::markers::Markers;
use crate::place;
use crate::recording::Recording;
use crate::report::{PassReport, RecordReport};
use crate::run::{Happening, Run};
use crate::touch::{self, Touching};

/// The CPU records one frame while the GPU draws the one before.
const FRAMES_IN_FLIGHT: usize = 2;
/// How long a runtime may take from the request to end until it says that the session is over.
const FAREWELL: Duration = Duration::from_secs(5);
/// How often a session that shows nothing is asked whether it does now.
const IDLE_POLL: Duration = Duration::from_millis(2);

/// How long a state that keeps the user from the scene may last before it is said: starts and ends pass through all.
const SILENCE: Duration = Duration::from_secs(1);

/// How a session ended.
pub(crate) enum End {
    /// As it should, in this state.
    Over(State),
    /// It was lost; a new one may be asked for.
    Lost(vergence_xr::Error),
}

/// What a session keeps from frame to frame.
struct Session {
    // Fields are dropped in this order: what uses the runtime's images before the client, the client before the device.
    renderer: Renderer,
    read_back: Option<gpu::ReadBack>,
    client: Client,
    device: Arc<gpu::Device>,
    touching: Option<Touching>,
    markers: Option<Markers>,
    is_simulated: bool,
    start: place::Start,
    /// Walked by thumbstick, world coordinates.
    walked: nalgebra::Vector3<f64>,
    /// `None` until the floor is known, and after the origin has moved.
    world_from_local: Option<Rigid>,
    recentring: Option<Recentring>,
    views: Vec<View>,
    slot: usize,
    first_display: Option<Timestamp>,
    /// Of the frame in which the user was followed last.
    followed: Option<Timestamp>,
    /// Frames that failed in a row.
    failed: u32,
}

/// Announced moves of LOCAL's origin: from the first on the floor is asked for anew, until the last has happened.
#[derive(Clone, Copy)]
struct Recentring {
    first: Timestamp,
    last: Timestamp,
}

impl Recentring {
    /// One more move, at the instant `at`.
    fn and(pending: Option<Self>, at: Timestamp) -> Self {
        pending
            .map_or(Self { first: at, last: at }, |p| Self { first: p.first.min(at), last: p.last.max(at) })
    }
}

/// What became of a frame.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Outcome {
    Shown,
    /// The runtime wants no picture now: nobody looks.
    Unasked,
    /// It wants one, and nothing could be drawn.
    Withheld,
}

/// CPU time of this thread that is ours: neither the driver's nor the runtime's.
#[derive(Clone, Copy)]
struct OurCpu {
    thread_ns: u64,
    driver_ns: u64,
    runtime_ns: i64,
}

impl OurCpu {
    fn now(client: &Client) -> Self {
        Self {
            thread_ns: gpu::thread_cpu_ns(),
            driver_ns: gpu::driver_time().ns,
            runtime_ns: client.runtime_cpu().as_nanos(),
        }
    }

    fn since(self, start: Self) -> Span {
        let thread = self.thread_ns.saturating_sub(start.thread_ns);
        let driver = self.driver_ns.saturating_sub(start.driver_ns);
        let runtime = u64::try_from(self.runtime_ns - start.runtime_ns).unwrap_or(0);
        let ours = thread.saturating_sub(driver).saturating_sub(runtime);
        Span::from_nanos(i64::try_from(ours).unwrap_or(i64::MAX))
    }
}

/// Runs one session to its end.
pub(crate) fn play(run: &mut Run<'_>, chosen: &Chosen) -> Result<End, Error> {
    let mut session = start(run, chosen)?;
    let ended = frames(run, &mut session);
    run.session_time = session.client.latest().max(run.session_time);
    run.book = book::take(&mut session.client);
    if session.client.is_hung() {
        // Whatever is destroyed now may not return either.
        if let Some(desk) = &mut run.desk {
            desk.detach();
        }
        let Session { renderer, client, .. } = session;
        drop(renderer);
        client.abandon();
        return ended;
    }
    if ended.as_ref().err().is_some_and(Error::is_stuck_device) {
        // Waiting for all of its work, as everything does that is destroyed, would be waiting for ever.
        std::mem::forget(run.desk.take());
        std::mem::forget(session);
        return ended;
    }
    if let Some(desk) = &mut run.desk {
        desk.detach();
    }
    if let Err(error) = session.device.wait_idle() {
        log::warn!("{error}");
    }
    let last_slot = (session.slot + FRAMES_IN_FLIGHT - 1) % FRAMES_IN_FLIGHT;
    let passes = session.renderer.timings(last_slot).unwrap_or_default();
    run.report.gpu_ms =
        passes.iter().map(|pass| PassReport { name: pass.name.to_owned(), ms: pass.ms }).collect();
    run.report.hands = Hand::BOTH.map(|hand| session.client.device_in(hand));
    if run.config.validation && session.device.instance().validation() {
        let count = session.device.instance().validation_count();
        run.report.validation_messages = Some(run.report.validation_messages.unwrap_or(0) + count);
    }
    run.report.touches.extend(session.touching.take().map(Touching::into_touches).unwrap_or_default());
    ended
}

fn start(run: &mut Run<'_>, chosen: &Chosen) -> Result<Session, Error> {
    let mut creator = chosen.connection.vulkan_creator();
    let validation = run.config.validation;
    let surface = run.desk.as_ref().and_then(Desk::display);
    let desc = gpu::InstanceDesc { app_name: "vergence", validation, surface };
    let instance = gpu::Instance::new(&desc, Some(&mut creator)).map_err(|error| creator.explain(error))?;
    if chosen.is_simulated {
        // The simulated headset goes by the same choice, and can say only that it failed.
        instance.check_devices()?;
    }
    let device_desc = gpu::DeviceDesc { present: surface.is_some(), ..gpu::DeviceDesc::default() };
    let device = gpu::Device::new(&instance, &device_desc, Some(&mut creator))
        .map_err(|error| creator.explain(error))?;
    if let Some(desk) = &mut run.desk {
        desk.attach(&device)?;
    }
    gpu::set_driver_clock(true);
    run.config.quality.check(device.limits())?;

    let mut client = Client::new(
        &chosen.connection,
        &device,
        &SessionDesc {
            near_m: run.config.quality.near_m,
            render_scale: run.config.quality.render_scale,
            actions: &run.plan.actions,
            hand_joints: run.config.hand_joints,
            eye_gaze: run.config.eye_gaze,
            refresh_rate_hz: run.config.refresh_rate_hz,
            wait_patience: Duration::try_from_secs_f64(run.config.hang_s).unwrap_or(Duration::MAX),
            without: run.again.as_ref().map_or(Without::default(), |again| again.without),
        },
    )?;
    if let Some(again) = &run.again {
        let replay = again.replay.clone();
        client.go_by(move || {
            let (display, period, is_faulty, rebased) = replay.taken_times()?;
            Some(TakenTimes { display, period, is_faulty, rebased })
        });
    }
    client.foretell(foresight::history());
    let pictures = client.pictures();
    let target = Target {
        color_format: pictures.color_format,
        depth_format: pictures.depth_format.unwrap_or(gpu::vk::Format::D32_SFLOAT),
        size: pictures.size,
        views: pictures.views,
    };
    let mut renderer =
        Renderer::new(&device, &run.marked, &run.plan.needs, &run.config.quality, &target, FRAMES_IN_FLIGHT)?;
    let masked = mask(&mut client, &mut renderer)?;
    let touching = Touching::new(&run.scene, &client);
    let markers = Markers::new(&run.scene, &mut renderer);

    let report = &mut run.report;
    report.device = format!("{} ({})", device.limits().name, device.limits().driver);
    report.software = device.limits().software;
    report.size = pictures.size;
    report.views = pictures.views;
    report.msaa = run.config.quality.msaa;
    report.depth_layer = pictures.depth_format.is_some();
    report.visibility_mask = masked;
    report.refresh_hz = client.refresh_rate_hz();
    report.extensions = chosen.connection.extensions().to_vec();
    report.profiles = client.accepted_profiles().iter().map(|&name| name.to_owned()).collect();
    if client.has_actions() {
        report.actions = run.plan.actions.actions.iter().map(|action| action.name.to_owned()).collect();
    }
    let runtime = report.runtime.clone();
    if run.config.hand_joints && !client.reads_hand_joints() {
        run.warn(&format!("the joints of the hands are not read: {runtime} does not offer them"));
    }
    if run.config.eye_gaze && !client.reads_gaze() {
        run.warn(&format!("the gaze is not read: {runtime} does not offer it"));
    }
    if let Some(guest) = &mut run.guest {
        guest.begins(Offered { gaze: client.reads_gaze(), hand_joints: client.reads_hand_joints() });
    }
    if !std::mem::replace(&mut run.has_booked, true) {
        run.book = open_book(run, chosen, &client);
    }
    run.begin_files()?;
    if let Some(book) = run.book.take() {
        client.set_tap(book);
        client.tell(|| Said::Event(Event::new(SESSION_BEGINS, "")));
    }
    Ok(Session {
        touching,
        markers,
        renderer,
        read_back: None,
        client,
        device,
        is_simulated: chosen.is_simulated,
        start: run.start.clone(),
        walked: nalgebra::Vector3::zeros(),
        world_from_local: None,
        recentring: None,
        views: Vec::with_capacity(Located::MOST_VIEWS),
        slot: 0,
        first_display: None,
        followed: None,
        failed: 0,
    })
}

/// What the run is to keep of itself; `None` where that is nothing, or cannot be made: the session goes on without.
fn open_book(run: &mut Run<'_>, chosen: &Chosen, client: &Client) -> Option<Box<Book>> {
    if let Some(again) = &mut run.again {
        let verifier = again.verifier.take()?(&run.report.device);
        return Some(Box::new(Book::new(None, Some(verifier), again.hash)));
    }
    let config = run.config.record.clone()?;
    let hashes = config.hash_frames.unwrap_or(chosen.is_simulated);
    match Recording::begin(run, &config, chosen, client, hashes) {
        Ok(recording) => Some(Box::new(Book::new(Some(recording), None, hashes))),
        Err(error) => {
            let sentence = format!("nothing is recorded: {}", with_cause(&error));
            run.say(&sentence);
            let path = config.path.display().to_string();
            run.report.recording =
                Some(RecordReport { path, error: Some(sentence), ..RecordReport::default() });
            None
        }
    }
}

/// Tells the renderer what the lenses hide; whether they hide anything.
fn mask(client: &mut Client, renderer: &mut Renderer) -> Result<bool, Error> {
    let areas: Vec<(Vec<[f32; 2]>, Vec<u32>)> =
        client.hidden_areas()?.into_iter().map(|area| (area.vertices, area.indices)).collect();
    // Also where nothing is hidden: that takes an earlier mask away.
    renderer.visibility_mask(&areas)?;
    Ok(areas.iter().any(|(_, indices)| !indices.is_empty()))
}

/// The loop, until the run or the session is over.
fn frames(run: &mut Run<'_>, session: &mut Session) -> Result<End, Error> {
    let patience = Duration::try_from_secs_f64(run.config.patience_s).unwrap_or(Duration::MAX);
    let mut waiting_since = Instant::now();
    let mut leaving: Option<Instant> = None;
    let mut waiting = Waiting::new();
    loop {
        let began = OurCpu::now(&session.client);
        let state = match session.client.poll() {
            Ok(state) => {
                if !state.is_running() {
                    // Frames count for themselves; where there are none, what goes right again is a poll.
                    session.failed = 0;
                }
                state
            }
            Err(error) => match forgive(run, session, error.into()) {
                Err(error) if leaving.is_some() => {
                    run.say(&format!("{error}; the session was ending anyway"));
                    return Ok(End::Over(State::Exiting));
                }
                forgiven => {
                    forgiven?;
                    session.client.state()
                }
            },
        };
        attend(run, session)?;
        if leaving.is_none() {
            waiting.follow(run, state);
        }
        match state {
            State::Running { .. } => match frame(run, session, began, leaving.is_some()) {
                Ok(Outcome::Shown) => waiting_since = Instant::now(),
                Ok(Outcome::Unasked) => {
                    // Nobody looks: nothing is missed meanwhile.
                    run.tally.pause();
                    forbear(run, &mut waiting_since);
                }
                Ok(Outcome::Withheld) => {}
                Err(error) if leaving.is_some() && !session.client.is_hung() => {
                    run.say(&format!("{error}; the session was ending anyway"));
                    return Ok(End::Over(State::Exiting));
                }
                Err(error) => return Err(error),
            },
            // While the session is ending anyway, it is not asked for anew.
            State::Lost { .. } if leaving.is_some() => return Ok(End::Over(State::Exiting)),
            State::Lost { .. } => return Ok(End::Lost(vergence_xr::Error::SessionLost { call: "an event" })),
            State::Exiting => return Ok(End::Over(state)),
            State::Idle | State::Flat | State::WaitingForRuntime => {
                run.tally.pause();
                forbear(run, &mut waiting_since);
                std::thread::sleep(IDLE_POLL);
            }
        }
        let closed = run.desk.as_mut().is_some_and(Desk::follow);
        if leaving.is_none() && (closed || is_over(run) || run.config.stop.is_stopped()) {
            if !state.is_running() {
                // Nothing to say farewell to; where the application left is part of the recording.
                session.client.tell(|| Said::Event(Event::new(EXIT_REQUESTED, "")));
                return Ok(End::Over(State::Exiting));
            }
            if let Err(error) = session.client.request_exit() {
                run.say(&format!("{error}; leaving without the runtime's answer"));
                return Ok(End::Over(State::Exiting));
            }
            leaving = Some(Instant::now());
        }
        if run.again.as_ref().is_some_and(|again| again.replay.is_run_over()) {
            // The run went no further: its runtime did not end the session in time.
            return Ok(End::Over(session.client.state()));
        }
        // A replay takes as long as its speed asks for, unless its user has enough of it.
        let is_hurried = run.again.is_none() || run.config.stop.is_stopped();
        if is_hurried && leaving.is_some_and(|since| since.elapsed() > FAREWELL) {
            run.say("the runtime did not end the session in time; leaving without its answer");
            return Ok(End::Over(session.client.state()));
        }
        // Who has a window can close it.
        if run.desk.is_none() && waiting_since.elapsed() > patience {
            return Err(Error::Stalled {
                waited_s: patience.as_secs(),
                state: session.client.state().sentence(),
            });
        }
    }
}

/// Who has used the headset may put it down for as long as they like; patience ends only with one that nobody puts on.
fn forbear(run: &Run<'_>, waiting_since: &mut Instant) {
    if run.tally.frames > 0 {
        *waiting_since = Instant::now();
    }
}

fn is_over(run: &Run<'_>) -> bool {
    if let Some(again) = &run.again {
        // When the application left is part of the recording.
        return again.replay.takes_exit_request();
    }
    run.guest_leaves
        || run.config.frames.is_some_and(|frames| run.tally.frames >= frames)
        || run.config.seconds.is_some_and(|seconds| run.tally.elapsed().as_secs_f64() >= seconds)
}

/// Says what keeps the user from the scene, once, when it has lasted for a while.
struct Waiting {
    state: State,
    since: Instant,
    said: bool,
}

impl Waiting {
    fn new() -> Self {
        Self { state: State::Idle, since: Instant::now(), said: false }
    }

    fn follow(&mut self, run: &mut Run<'_>, state: State) {
        if state != self.state {
            *self = Self { state, ..Self::new() };
        }
        if !self.said && self.since.elapsed() >= SILENCE {
            self.said = true;
            let hands_matter = !run.plan.actions.actions.is_empty();
            if state.keeps_user_from_scene() && (hands_matter || !state.is_visible()) {
                run.say(state.sentence());
            }
        }
    }
}

/// Follows what has happened. What the user did, or can do nothing about, is kept for the report only.
fn attend(run: &mut Run<'_>, session: &mut Session) -> Result<(), Error> {
    let mut mask_changed = false;
    let recording = book::of(&mut session.client).and_then(|book| book.recording.as_mut());
    if let Some(error) = recording.and_then(|recording| recording.failure()) {
        let sentence = format!("{}; the session goes on", with_cause(&error));
        run.say(&sentence);
        run.report.recording.get_or_insert_default().error = Some(sentence);
    }
    let Session { client, recentring, .. } = session;
    for notice in client.drain_notices() {
        match notice {
            Notice::State(state) => run.report.states.push(state.name().to_owned()),
            Notice::Recentred { at } => *recentring = Some(Recentring::and(*recentring, at)),
            Notice::HiddenAreaChanged => mask_changed = true,
            Notice::HandsChanged
            | Notice::RefreshRate { .. }
            | Notice::Time(_)
            | Notice::EventsLost(_)
            | Notice::Nonsense
            | Notice::LossPending
            | Notice::FrameDiscarded => {}
        }
        log::info!("{notice}");
        if !matches!(notice, Notice::State(_) | Notice::HandsChanged) {
            run.note(&notice.to_string());
        }
    }
    run.report.notices_left_out += session.client.take_notices_left_out();
    if mask_changed {
        session.device.wait_idle()?;
        run.report.visibility_mask = mask(&mut session.client, &mut session.renderer)?;
    }
    Ok(())
}

/// So many frames in a row may fail before the session is given up: what goes wrong once goes right the next time.
const FORGIVEN: u32 = 5;

/// Goes on after a call that failed and took nothing away.
///
/// # Errors
/// The failure, where it is a loss or one of too many.
fn forgive(run: &mut Run<'_>, session: &mut Session, error: Error) -> Result<(), Error> {
    let passes = match &error {
        Error::Headset(vergence_xr::Error::Call { .. }) => {
            !matches!(session.client.state(), State::Lost { .. })
        }
        _ => false,
    };
    session.failed += 1;
    if !passes || session.failed > FORGIVEN {
        return Err(error);
    }
    run.say(&format!("{error}; going on without this frame"));
    Ok(())
}

/// One frame. Where a call fails, it is left out.
fn frame(run: &mut Run<'_>, session: &mut Session, began: OurCpu, leaving: bool) -> Result<Outcome, Error> {
    match attempt(run, session, began, leaving) {
        Ok(outcome) => {
            session.failed = 0;
            return Ok(outcome);
        }
        Err(error) => forgive(run, session, error)?,
    }
    if let Err(error) = session.client.drop_frame() {
        forgive(run, session, error.into())?;
    }
    Ok(Outcome::Withheld)
}

fn attempt(run: &mut Run<'_>, session: &mut Session, began: OurCpu, leaving: bool) -> Result<Outcome, Error> {
    let frame = session.client.wait()?;
    session.client.begin()?;
    // One that could not be begun is given again, and counts once.
    run.tally.paced += 1;
    let display = frame.prediction.display;
    if frame.prediction.rebased {
        // The time between this frame and the one before has not passed.
        run.tally.pause();
        session.first_display = None;
        session.followed = None;
        if let Some(beside) = &mut run.beside {
            beside.rebase();
        }
        session.client.forget_motion();
    }
    if leaving || !frame.should_render {
        if !leaving && session.client.state() == (State::Running { visible: true, focused: true }) {
            // Nobody looks, but the hands are still ours.
            session.client.locate(display)?;
            session.client.sync_input(display)?;
            let head = session.client.locate_head(display)?.reference_from_device();
            follow_user(run, session, &frame, head.as_ref())?;
        }
        session.client.end(&frame, None)?;
        return Ok(Outcome::Unasked);
    }
    let Some(culled) = session.client.locate(display)? else {
        session.client.end(&frame, None)?;
        return Ok(Outcome::Withheld);
    };
    session.client.sync_input(display)?;
    let head = session.client.locate_head(display)?.reference_from_device();
    let world_from_local = follow_user(run, session, &frame, head.as_ref())?;
    if let Some(ours) = run.beside.as_mut().and_then(|beside| beside.at(display, head.as_ref()))
        && let Some(recording) = book::of(&mut session.client).and_then(|book| book.recording.as_mut())
    {
        recording.beside(display, &ours);
    }

    let Some(images) = session.client.acquire()? else {
        session.client.end(&frame, None)?;
        return Ok(Outcome::Withheld);
    };
    let attachments = Attachments::swapchain(&images.color, images.depth.as_ref());
    let first_display = *session.first_display.get_or_insert(display);
    let animation_time = display.since(first_display).unwrap_or(Span::ZERO);
    see(&mut session.views, &world_from_local, &culled);
    session.renderer.begin(session.slot, animation_time, &session.views, &attachments)?;

    let asked = Instant::now();
    let shown = session.client.locate(display)?.unwrap_or(culled);
    see(&mut session.views, &world_from_local, &shown);
    session.renderer.latch(session.slot, &session.views)?;
    session.renderer.submit(session.slot)?;
    let pose_age = asked.elapsed();
    session.slot = (session.slot + 1) % FRAMES_IN_FLIGHT;

    let drawn = OurCpu::now(&session.client);
    photograph(run, session, &frame, &shown, head.as_ref(), &images)?;
    hash_pictures(session, &images)?;
    mirror(run, &images, session.client.pictures().views)?;
    let photographed = OurCpu::now(&session.client);
    session.client.end(&frame, Some(&shown))?;
    let ended = OurCpu::now(&session.client);
    // Taking pictures is not part of a frame.
    let ours = drawn.since(began).as_nanos() + ended.since(photographed).as_nanos();

    let number = run.tally.frames;
    let pose_age = Span::from_nanos(i64::try_from(pose_age.as_nanos()).unwrap_or(i64::MAX));
    run.tally.shown(display, frame.prediction.period);
    run.tally.frame_cpu.add(Span::from_nanos(ours));
    run.tally.pose_age.add(pose_age);
    if let Some(book) = book::of(&mut session.client) {
        book.diagnose(Span::from_nanos(ours), pose_age);
    }
    if let Some(log) = &mut run.pose_log {
        let eyes = (0..shown.views().len()).filter_map(|view| shown.as_said(view));
        let head = head.as_ref().map(vergence_geom::components);
        log.write(number, display, head, eyes.map(|(pose, fov)| (pose.map(f64::from), fov.map(f64::from))))?;
    }
    (run.watch)(Happening::Frame { shown: run.tally.frames, seconds: run.tally.elapsed().as_secs_f64() });
    Ok(Outcome::Shown)
}

/// Hashes what was drawn, where the book asks for it. Waits for the GPU and reads back.
fn hash_pictures(session: &mut Session, images: &vergence_xr::Attachments) -> Result<(), Error> {
    let Session { client, read_back, device, .. } = session;
    let views = client.pictures().views;
    let Some(book) = book::of(client).filter(|book| book.hashes) else { return Ok(()) };
    let frame = book.frame();
    let reader = match read_back {
        Some(reader) => reader,
        None => read_back.insert(gpu::ReadBack::new(device)?),
    };
    for view in 0..views {
        let mut hash = None;
        let see = |bytes: &[u8]| hash = Some(book::hash(frame, view, bytes));
        reader.look(images.color.image(), view, gpu::Use::ColorAttachment, see)?;
        if let Some(hash) = hash {
            client.tell(|| Said::Hash(hash));
        }
    }
    Ok(())
}

/// Shows the frame in the window, where there is one. A window that is gone takes nothing from the headset.
fn mirror(run: &mut Run<'_>, images: &vergence_xr::Attachments, views: u32) -> Result<(), Error> {
    let Some(desk) = &mut run.desk else { return Ok(()) };
    match desk.show(images.color.image(), views) {
        Err(error @ Error::Gpu(gpu::Error::Surface { .. })) => {
            desk.detach();
            run.say(&format!("{error}; going on without the mirror"));
            Ok(())
        }
        shown => shown,
    }
}

/// The located eyes in world coordinates.
fn see(views: &mut Vec<View>, world_from_local: &Rigid, located: &Located) {
    views.clear();
    views.extend_from_slice(located.views());
    in_world(world_from_local, located, views);
}

/// Where LOCAL is in the world now: at the scene's start, and as far as the user has walked.
fn follow_user(
    run: &mut Run<'_>,
    session: &mut Session,
    frame: &Frame,
    head: Option<&Rigid>,
) -> Result<Rigid, Error> {
    let display = frame.prediction.display;
    if let Some(moves) = session.recentring.filter(|moves| moves.first <= display) {
        session.world_from_local = None;
        session.client.forget_motion();
        if let Some(touching) = &mut session.touching {
            touching.recentred();
        }
        session.recentring = Some(moves).filter(|moves| moves.last > display);
    }
    let placed = match session.world_from_local {
        Some(placed) => placed,
        None => {
            let located = session.client.local_from_floor(display)?;
            let located = located.filter(|_| session.start.is_floor);
            let world_from_local =
                |floor: &Rigid| place::world_from_local(&session.start.world_from_start, floor);
            // An assumed floor serves this frame only: the next one may know the real one.
            session.world_from_local = located.as_ref().map(world_from_local);
            if !session.start.is_floor {
                // What is before the eyes is so for tall people, too.
                session.world_from_local = Some(world_from_local(&place::assumed_floor()));
            }
            session.world_from_local.unwrap_or_else(|| world_from_local(&place::assumed_floor()))
        }
    };
    let world_from_local = nalgebra::Translation3::from(session.walked) * placed;
    if let Some(touching) = &mut session.touching {
        let step = touch::step(session.followed.replace(display), display, frame.prediction.period);
        // The same as the renderer's: a replay is told the same displays.
        let begun = session.first_display.unwrap_or(display);
        touching.move_targets(display.since(begun).unwrap_or(Span::ZERO));
        session.walked +=
            touching.follow(&mut session.client, &world_from_local, head, run.tally.frames, step)?;
        if let Some(markers) = &session.markers {
            markers.follow(&mut session.renderer, touching);
        }
    }
    if let Some(guest) = &mut run.guest {
        let now = guest::moment(&session.client, &world_from_local, head, display, frame.prediction.period);
        let mut stage = Stage { renderer: &mut session.renderer, client: &mut session.client };
        run.guest_leaves |= !guest.follow(&now, &mut stage);
    }
    Ok(nalgebra::Translation3::from(session.walked) * placed)
}

/// Takes a picture of what was drawn; the simulated headset takes them of what it composes.
fn photograph(
    run: &Run<'_>,
    session: &mut Session,
    frame: &Frame,
    shown: &Located,
    head: Option<&Rigid>,
    images: &vergence_xr::Attachments,
) -> Result<(), Error> {
    let Some(capture) = run.capture.as_ref().filter(|_| !session.is_simulated) else { return Ok(()) };
    let number = run.tally.frames;
    let seconds_left = run.config.seconds.map(|s| s - run.tally.elapsed().as_secs_f64());
    let is_last = run.config.frames == Some(number + 1)
        || seconds_left.is_some_and(|left| left <= 1.5 * frame.prediction.period.as_secs_f64());
    if !(capture.wants(number) || is_last) {
        return Ok(());
    }
    let Session { read_back, device, .. } = session;
    let reader = match read_back {
        Some(reader) => reader,
        None => read_back.insert(gpu::ReadBack::new(device)?),
    };
    let image = images.color.image();
    let mut eyes = Vec::with_capacity(shown.views().len());
    for view in 0..shown.views().len() {
        let Some((pose, fov)) = shown.as_said(view) else { continue };
        let mut rgba = Vec::new();
        reader.layer(image, view as u32, gpu::Use::ColorAttachment, &mut rgba)?;
        if image.format() == gpu::vk::Format::B8G8R8A8_SRGB {
            rgba.chunks_exact_mut(4).for_each(|pixel| pixel.swap(0, 2));
        }
        eyes.push((pose.map(f64::from), fov.map(f64::from), rgba));
    }
    capture.take(Picture {
        frame: number,
        display: frame.prediction.display,
        size: image.size(0),
        head: head.map(vergence_geom::components),
        eyes,
    });
    Ok(())
}
