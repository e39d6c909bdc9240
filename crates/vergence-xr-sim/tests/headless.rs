//! The runtime through the `openxr` crate, without graphics: needs no device at all.
#![allow(clippy::unwrap_used, reason = "a test fails where it cannot go on")]
#![allow(unsafe_code, reason = "the runtime is called through its C interface")]

use openxr as xr;
use vergence_time::Timestamp;
use vergence_xr_sim::{
    ClockMode, Config, Control, Controller, Hand, PoseProvider, Presence, Profile, Runtime, Still, Tracked,
    get_instance_proc_addr,
};
use xr::SessionState as S;
use xr::sys;
use xr::sys::Handle as _;

type Rigid = vergence_geom::Rigid;

fn entry() -> xr::Entry {
    // SAFETY: the runtime follows the specification.
    unsafe { xr::Entry::from_get_instance_proc_addr(get_instance_proc_addr, &()).unwrap() }
}

fn instance_with(
    config: Config,
    version: xr::Version,
    extensions: &xr::ExtensionSet,
) -> xr::Result<xr::Instance> {
    Runtime::configure(config);
    let info = xr::ApplicationInfo {
        application_name: "test",
        application_version: 1,
        engine_name: "",
        engine_version: 0,
        api_version: version,
    };
    entry().create_instance(&info, extensions, &[], &())
}

fn all() -> xr::ExtensionSet {
    let mut extensions = xr::ExtensionSet::default();
    extensions.mnd_headless = true;
    extensions.khr_visibility_mask = true;
    extensions.khr_convert_timespec_time = true;
    extensions.fb_display_refresh_rate = true;
    extensions.ext_local_floor = true;
    extensions
}

const V1_0: xr::Version = xr::Version::new(1, 0, 0);
const V1_1: xr::Version = xr::Version::new(1, 1, 0);
const STEREO: xr::ViewConfigurationType = xr::ViewConfigurationType::PRIMARY_STEREO;
const OPAQUE: xr::EnvironmentBlendMode = xr::EnvironmentBlendMode::OPAQUE;

struct Client {
    instance: xr::Instance,
    session: xr::Session<xr::Headless>,
    waiter: xr::FrameWaiter,
    stream: xr::FrameStream<xr::Headless>,
    states: Vec<xr::SessionState>,
}

impl Client {
    fn begun(config: Config) -> Self {
        let instance = instance_with(config, V1_0, &all()).unwrap();
        let system = instance.system(xr::FormFactor::HEAD_MOUNTED_DISPLAY).unwrap();
        // SAFETY: a headless session has no graphics binding.
        let (session, waiter, stream) = unsafe {
            instance.create_session::<xr::Headless>(system, &xr::headless::SessionCreateInfo {}).unwrap()
        };
        let mut client = Self { instance, session, waiter, stream, states: Vec::new() };
        client.poll();
        client.session.begin(STEREO).unwrap();
        client.poll();
        client
    }

    fn poll(&mut self) {
        let mut buffer = xr::EventDataBuffer::new();
        while let Some(event) = self.instance.poll_event(&mut buffer).unwrap() {
            if let xr::Event::SessionStateChanged(event) = event {
                self.states.push(event.state());
            }
        }
    }

    /// The states entered since the last time.
    fn entered(&mut self) -> Vec<xr::SessionState> {
        self.poll();
        std::mem::take(&mut self.states)
    }

    fn frame(&mut self) -> xr::FrameState {
        let state = self.waiter.wait().unwrap();
        self.stream.begin().unwrap();
        self.stream.end(state.predicted_display_time, OPAQUE, &[]).unwrap();
        state
    }

    fn space(&self, ty: xr::ReferenceSpaceType) -> xr::Space {
        self.session.create_reference_space(ty, xr::Posef::IDENTITY).unwrap()
    }
}

#[rustfmt::skip]
const CORE: [&str; 55] = [
    "xrGetInstanceProcAddr", "xrEnumerateApiLayerProperties", "xrEnumerateInstanceExtensionProperties",
    "xrCreateInstance", "xrDestroyInstance", "xrGetInstanceProperties", "xrPollEvent", "xrResultToString",
    "xrStructureTypeToString", "xrGetSystem", "xrGetSystemProperties", "xrEnumerateEnvironmentBlendModes",
    "xrCreateSession", "xrDestroySession", "xrEnumerateReferenceSpaces", "xrCreateReferenceSpace",
    "xrGetReferenceSpaceBoundsRect", "xrCreateActionSpace", "xrLocateSpace", "xrDestroySpace",
    "xrEnumerateViewConfigurations", "xrGetViewConfigurationProperties", "xrEnumerateViewConfigurationViews",
    "xrEnumerateSwapchainFormats", "xrCreateSwapchain", "xrDestroySwapchain", "xrEnumerateSwapchainImages",
    "xrAcquireSwapchainImage", "xrWaitSwapchainImage", "xrReleaseSwapchainImage", "xrBeginSession", "xrEndSession",
    "xrRequestExitSession", "xrWaitFrame", "xrBeginFrame", "xrEndFrame", "xrLocateViews", "xrStringToPath",
    "xrPathToString", "xrCreateActionSet", "xrDestroyActionSet", "xrCreateAction", "xrDestroyAction",
    "xrSuggestInteractionProfileBindings", "xrAttachSessionActionSets", "xrGetCurrentInteractionProfile",
    "xrGetActionStateBoolean", "xrGetActionStateFloat", "xrGetActionStateVector2f", "xrGetActionStatePose",
    "xrSyncActions", "xrEnumerateBoundSourcesForAction", "xrGetInputSourceLocalizedName", "xrApplyHapticFeedback",
    "xrStopHapticFeedback",
];

fn ask(instance: sys::Instance, name: &str) -> Result<sys::pfn::VoidFunction, sys::Result> {
    let name = std::ffi::CString::new(name).unwrap();
    let mut function = None;
    // SAFETY: the name ends with a zero and the place is ours.
    let code = unsafe { get_instance_proc_addr(instance, name.as_ptr(), &mut function) };
    if code == sys::Result::SUCCESS { Ok(function.expect("success gives a function")) } else { Err(code) }
}

#[test]
fn every_core_name_resolves_and_no_other() {
    let instance = instance_with(Config::default(), V1_0, &xr::ExtensionSet::default()).unwrap();
    for name in CORE {
        assert!(ask(instance.as_raw(), name).is_ok(), "{name}");
        let without_instance = CORE[..4].contains(&name);
        let expected = if without_instance { None } else { Some(sys::Result::ERROR_HANDLE_INVALID) };
        assert_eq!(ask(sys::Instance::NULL, name).err(), expected, "{name}");
    }
    for name in ["xrGetVisibilityMaskKHR", "xrLocateSpaces", "xrNoSuchFunction", ""] {
        let refused = ask(instance.as_raw(), name).err();
        assert_eq!(refused, Some(sys::Result::ERROR_FUNCTION_UNSUPPORTED), "{name}");
    }
    let newer = instance_with(Config::default(), V1_1, &all()).unwrap();
    assert!(ask(newer.as_raw(), "xrLocateSpaces").is_ok());
    assert!(ask(newer.as_raw(), "xrGetVisibilityMaskKHR").is_ok());
    let invented = ask(sys::Instance::from_raw(0xdead_beef), "xrPollEvent").err();
    assert_eq!(invented, Some(sys::Result::ERROR_HANDLE_INVALID));
}

#[test]
fn versions_layers_and_extensions_are_negotiated() {
    for (major, minor, accepted) in [(1, 0, true), (1, 1, true), (1, 2, false), (2, 0, false), (0, 9, false)]
    {
        let version = xr::Version::new(major, minor, 0);
        let made = instance_with(Config::default(), version, &xr::ExtensionSet::default());
        let expected = if accepted { None } else { Some(sys::Result::ERROR_API_VERSION_UNSUPPORTED) };
        assert_eq!(made.err(), expected, "{major}.{minor}");
    }
    let mut unknown = xr::ExtensionSet::default();
    unknown.ext_plane_detection = true;
    let made = instance_with(Config::default(), V1_0, &unknown);
    assert_eq!(made.err(), Some(sys::Result::ERROR_EXTENSION_NOT_PRESENT));
    let offered = entry().enumerate_extensions().unwrap();
    assert!(offered.khr_vulkan_enable2 && offered.khr_composition_layer_depth && offered.khr_visibility_mask);
    assert!(entry().enumerate_layers().unwrap().is_empty());
    let instance = instance_with(Config::default(), V1_0, &all()).unwrap();
    assert_eq!(instance.properties().unwrap().runtime_name, "Vergence simulated runtime");
}

#[test]
fn a_headless_session_runs_from_idle_to_exiting() {
    let mut client = Client::begun(Config::default());
    assert_eq!(client.entered(), [S::IDLE, S::READY, S::SYNCHRONIZED, S::VISIBLE, S::FOCUSED]);
    assert_eq!(client.session.begin(STEREO).err(), Some(sys::Result::ERROR_SESSION_RUNNING));
    assert_eq!(client.session.end().err(), Some(sys::Result::ERROR_SESSION_NOT_STOPPING));
    for _ in 0..100 {
        assert!(!client.frame().should_render);
    }
    client.session.request_exit().unwrap();
    assert_eq!(client.entered(), [S::VISIBLE, S::SYNCHRONIZED, S::STOPPING]);
    client.session.end().unwrap();
    assert_eq!(client.entered(), [S::IDLE, S::EXITING]);
    let not_running = Some(sys::Result::ERROR_SESSION_NOT_RUNNING);
    assert_eq!(client.session.request_exit().err(), not_running);
    assert_eq!(client.waiter.wait().err(), not_running);
    assert_eq!(client.session.begin(STEREO).err(), Some(sys::Result::ERROR_SESSION_NOT_READY));
}

#[test]
fn a_headset_that_is_taken_off_stops_the_session_and_readies_it_when_put_on() {
    let control = Control::default();
    let mut client = Client::begun(Config { control: control.clone(), ..Config::default() });
    control.set_presence(Presence::Away);
    assert_eq!(client.entered().split_off(5), [S::VISIBLE, S::SYNCHRONIZED, S::STOPPING]);
    client.session.end().unwrap();
    assert_eq!(client.entered(), [S::IDLE]);
    control.set_presence(Presence::Focused);
    assert_eq!(client.entered(), [S::READY]);
    client.session.begin(STEREO).unwrap();
    client.frame();
}

/// A script takes the headset off and puts it on again, on a clock that nothing but frames and questions moves.
#[test]
fn a_script_hides_takes_off_puts_on_and_recentres() {
    let text = r#"
        at-end = "stop"
        duration = "0.5 s"
        [[head]]
        time = "0 s"
        position = ["1 m", "1.5 m", "0 m"]
        [[headset]]
        time = "0.1 s"
        presence = "hidden"
        [[headset]]
        time = "0.2 s"
        presence = "away"
        [[headset]]
        time = "0.3 s"
        presence = "focused"
        recentre = true
    "#;
    let script = vergence_xr_sim::Script::parse("script.toml".as_ref(), text).unwrap();
    let mut client = Client::begun(Config { motion: Box::new(script), ..Config::default() });
    let [local, stage] =
        [xr::ReferenceSpaceType::LOCAL, xr::ReferenceSpaceType::STAGE].map(|ty| client.space(ty));
    let mut frames = 0;
    for _ in 0..1000 {
        client.poll();
        match client.states.last().copied() {
            Some(S::EXITING) => break,
            Some(S::STOPPING) => drop(client.session.end().unwrap()),
            Some(S::READY) => {
                let at = xr::Time::from_nanos(1_300_000_000);
                assert_eq!(stage.locate(&local, at).unwrap().pose.position.y, -1.5);
                client.session.begin(STEREO).unwrap();
            }
            Some(S::IDLE) => {}
            _ => {
                client.frame();
                frames += 1;
            }
        }
    }
    let all = &client.states;
    assert_eq!(
        all[5..],
        [
            S::VISIBLE,
            S::SYNCHRONIZED,
            S::STOPPING,
            S::IDLE,
            S::READY,
            S::SYNCHRONIZED,
            S::VISIBLE,
            S::FOCUSED,
            S::VISIBLE,
            S::SYNCHRONIZED,
            S::STOPPING,
            S::IDLE,
            S::EXITING,
        ],
        "{all:?}"
    );
    // At 90 Hz: 0.2 s before, 0.2 s after.
    assert!((34..=38).contains(&frames), "{frames}");
}

#[test]
fn frames_follow_one_another_in_order() {
    let mut client = Client::begun(Config::default());
    let out_of_order = Some(sys::Result::ERROR_CALL_ORDER_INVALID);
    assert_eq!(client.stream.begin().err(), out_of_order);
    let end =
        |client: &mut Client, nanos, mode| client.stream.end(xr::Time::from_nanos(nanos), mode, &[]).err();
    assert_eq!(end(&mut client, 1, OPAQUE), out_of_order);
    client.waiter.wait().unwrap();
    client.stream.begin().unwrap();
    client.waiter.wait().unwrap();
    let begin = client.session.instance().fp().begin_frame;
    // SAFETY: the session lives; a null info is allowed.
    let discarded = unsafe { begin(client.session.as_raw(), std::ptr::null()) };
    assert_eq!(discarded, sys::Result::FRAME_DISCARDED);
    assert_eq!(end(&mut client, 0, OPAQUE), Some(sys::Result::ERROR_TIME_INVALID));
    let additive = end(&mut client, 5, xr::EnvironmentBlendMode::ADDITIVE);
    assert_eq!(additive, Some(sys::Result::ERROR_ENVIRONMENT_BLEND_MODE_UNSUPPORTED));
    assert_eq!(end(&mut client, 5, OPAQUE), None);
}

/// A second `xrWaitFrame` waits for the first frame to begin, on whatever thread that happens.
#[test]
fn wait_frame_blocks_until_the_frame_before_has_begun() {
    let Client { session, mut waiter, mut stream, .. } = Client::begun(Config::default());
    waiter.wait().unwrap();
    let begun = std::sync::atomic::AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            std::thread::sleep(std::time::Duration::from_millis(50));
            begun.store(true, std::sync::atomic::Ordering::SeqCst);
            stream.begin().unwrap();
        });
        waiter.wait().unwrap();
        assert!(begun.load(std::sync::atomic::Ordering::SeqCst));
    });
    drop(session);
}

#[test]
fn the_virtual_clock_advances_by_the_period_whatever_the_load() {
    let times = |slow: bool| {
        let mut client = Client::begun(Config::default());
        let one = |frame| {
            if slow && frame % 7 == 0 {
                std::thread::sleep(std::time::Duration::from_millis(30));
            }
            let state = client.frame();
            assert_eq!(state.predicted_display_period.as_nanos(), 11_111_111);
            state.predicted_display_time.as_nanos()
        };
        (0..20).map(one).collect::<Vec<i64>>()
    };
    let (fast, slow) = (times(false), times(true));
    assert_eq!(fast, slow);
    assert!(fast.windows(2).all(|pair| pair[1] - pair[0] == 11_111_111));
}

/// Paced by the wall clock, and an application that is late loses whole periods, not the rhythm.
#[test]
fn real_time_waits_for_the_wall_clock_and_skips_periods_when_late() {
    const PERIOD: i64 = 11_111_111;
    let mut client = Client::begun(Config { clock: ClockMode::RealTime, ..Config::default() });
    let start = std::time::Instant::now();
    let first = client.frame().predicted_display_time.as_nanos();
    let mut last = first;
    for frame in 0..12 {
        if frame == 6 {
            std::thread::sleep(std::time::Duration::from_millis(40));
        }
        let time = client.frame().predicted_display_time.as_nanos();
        assert_eq!((time - first) % PERIOD, 0, "the rhythm stays");
        assert!(time > last);
        assert!(frame != 6 || time - last >= 3 * PERIOD, "40 ms are three periods");
        last = time;
    }
    // xrWaitFrame returns one period before the display, never earlier.
    let elapsed = i64::try_from(start.elapsed().as_nanos()).unwrap();
    assert!(elapsed >= last - first - 2 * PERIOD, "{elapsed} ns for {} ns", last - first);
}

#[test]
fn what_is_not_tracked_is_said_not_to_be() {
    struct Fading;
    impl PoseProvider for Fading {
        fn head(&self, at: Timestamp) -> Tracked {
            match at.as_nanos() {
                ..20_000_000 => Still::default().head(at),
                20_000_000..30_000_000 => Tracked::Held(Rigid::translation(0.0, 1.6, 0.0)),
                _ => Tracked::Lost,
            }
        }
        fn controller(&self, _: Hand, _: Timestamp) -> Controller {
            Controller::absent()
        }
    }
    use xr::SpaceLocationFlags as F;
    let mut client = Client::begun(Config { motion: Box::new(Fading), ..Config::default() });
    let local = client.space(xr::ReferenceSpaceType::LOCAL);
    let view = client.space(xr::ReferenceSpaceType::VIEW);
    let valid = F::ORIENTATION_VALID | F::POSITION_VALID;
    let tracked = F::ORIENTATION_TRACKED | F::POSITION_TRACKED;
    for (flags, view_flags) in [(valid | tracked, 4), (valid, 2), (F::EMPTY, 0)] {
        let time = client.frame().predicted_display_time;
        assert_eq!(view.locate(&local, time).unwrap().location_flags, flags);
        let found = client.session.locate_views(STEREO, time, &local).unwrap();
        assert_eq!(found.0.into_raw().count_ones(), view_flags);
        assert_eq!(found.1.len(), 2);
    }
}

/// The head that the tests of views look through: somewhere, turned about all axes, moving.
struct Moving;

impl PoseProvider for Moving {
    fn head(&self, at: Timestamp) -> Tracked {
        let t = at.as_nanos() as f64 * 1e-9;
        let place = nalgebra::Vector3::new(1.0 + t, 1.7, -2.0 * t);
        Tracked::Seen(Rigid::new(place, nalgebra::Vector3::new(0.2, 0.5 + t, -0.1)))
    }

    fn controller(&self, _: Hand, _: Timestamp) -> Controller {
        Controller::absent()
    }
}

fn rigid(pose: &xr::Posef) -> Rigid {
    let (q, p) = (pose.orientation, pose.position);
    let quaternion = nalgebra::Quaternion::new(q.w, q.x, q.y, q.z).cast::<f64>();
    let rotation = nalgebra::UnitQuaternion::new_normalize(quaternion);
    Rigid::from_parts(nalgebra::Vector3::new(p.x, p.y, p.z).cast::<f64>().into(), rotation)
}

/// Located views are `f32`: a metre away from the origin that is 1e-7.
const LOCATED: f64 = 1e-6;

#[test]
fn eyes_differ_by_exactly_the_eye_offset() {
    for name in ["default", "quest3", "index"] {
        let profile = Profile::open(name).unwrap();
        let config = Config { profile: profile.clone(), motion: Box::new(Moving), ..Config::default() };
        let mut client = Client::begun(config);
        let stage = client.space(xr::ReferenceSpaceType::STAGE);
        for _ in 0..10 {
            let time = client.frame().predicted_display_time;
            let (flags, views) = client.session.locate_views(STEREO, time, &stage).unwrap();
            assert!(flags.contains(xr::ViewStateFlags::POSITION_TRACKED));
            let (left, right) = (rigid(&views[0].pose), rigid(&views[1].pose));
            let found = left.inverse() * right;
            let truth = profile.eyes[0].head_from_eye.inverse() * profile.eyes[1].head_from_eye;
            assert!(
                (found.translation.vector - truth.translation.vector).norm() < LOCATED,
                "{name}: {found}"
            );
            assert!(found.rotation.angle_to(&truth.rotation) < LOCATED, "{name}");
            // Motion time 0 is when the session began: at one second on the virtual clock.
            let since = time.as_nanos() - 1_000_000_000;
            let head = Moving.head(Timestamp::from_nanos(since)).pose().unwrap();
            let eye = head * profile.eyes[0].head_from_eye;
            assert!((left.translation.vector - eye.translation.vector).norm() < LOCATED, "{name}");
            assert_eq!(views[0].fov.angle_left, profile.eyes[0].fov.left_rad as f32);
        }
    }
}

#[test]
fn spaces_are_where_they_should_be() {
    let mut client = Client::begun(Config::default());
    let time = client.frame().predicted_display_time;
    use xr::ReferenceSpaceType as R;
    let [view, local, stage, floor] =
        [R::VIEW, R::LOCAL, R::STAGE, R::LOCAL_FLOOR].map(|ty| client.space(ty));
    let position = |space: &xr::Space, base: &xr::Space| {
        let p = space.locate(base, time).unwrap().pose.position;
        [p.x, p.y, p.z]
    };
    assert_eq!(position(&view, &local), [0.0, 0.0, 0.0]);
    assert_eq!(position(&view, &stage), [0.0, 1.6, 0.0]);
    assert_eq!(position(&local, &floor), [0.0, 1.6, 0.0]);
    assert_eq!(position(&stage, &view), [0.0, -1.6, 0.0]);
    let untimely = view.locate(&stage, xr::Time::from_nanos(0));
    assert_eq!(untimely.err(), Some(sys::Result::ERROR_TIME_INVALID));
    let mut zero = xr::Posef::IDENTITY;
    zero.orientation.w = 0.0;
    let made = client.session.create_reference_space(R::VIEW, zero);
    assert_eq!(made.err(), Some(sys::Result::ERROR_POSE_INVALID));
    assert!(client.session.reference_space_bounds_rect(R::STAGE).unwrap().is_some());
    assert!(client.session.reference_space_bounds_rect(R::LOCAL).unwrap().is_none());
}

#[test]
fn velocities_are_those_of_the_motion() {
    let mut client = Client::begun(Config { motion: Box::new(Moving), ..Config::default() });
    let time = client.frame().predicted_display_time;
    use xr::ReferenceSpaceType as R;
    let (view, stage) = (client.space(R::VIEW), client.space(R::STAGE));
    let (_, velocity) = view.relate(&stage, time).unwrap();
    let v = velocity.linear_velocity;
    for (found, truth) in [(v.x, 1.0), (v.y, 0.0), (v.z, -2.0)] {
        assert!((found - truth).abs() < 1e-4, "{v:?}");
    }
    assert!(velocity.velocity_flags.contains(xr::SpaceVelocityFlags::ANGULAR_VALID));
}

#[test]
fn recentring_moves_the_local_space_and_says_so() {
    let control = Control::default();
    let config = Config { motion: Box::new(Moving), control: control.clone(), ..Config::default() };
    let mut client = Client::begun(config);
    client.frame();
    control.recentre();
    let mut buffer = xr::EventDataBuffer::new();
    let mut changed = Vec::new();
    while let Some(event) = client.instance.poll_event(&mut buffer).unwrap() {
        if let xr::Event::ReferenceSpaceChangePending(event) = event {
            changed.push((event.reference_space_type(), event.pose_valid()));
        }
    }
    use xr::ReferenceSpaceType as R;
    assert_eq!(changed, [(R::LOCAL, true), (R::LOCAL_FLOOR, true)]);
    let (view, local) = (client.space(R::VIEW), client.space(R::LOCAL));
    let time = client.frame().predicted_display_time;
    let p = view.locate(&local, time).unwrap().pose.position;
    // Two frames after the instant of recentring, at √5 m/s.
    assert!(p.x.hypot(p.y).hypot(p.z) < 0.06, "{p:?}");
}

#[test]
fn what_is_lost_stays_lost_and_can_be_destroyed() {
    let control = Control::default();
    let mut client = Client::begun(Config { control: control.clone(), ..Config::default() });
    client.entered();
    control.lose_session();
    assert_eq!(client.entered(), [S::LOSS_PENDING]);
    assert_eq!(client.waiter.wait().err(), Some(sys::Result::ERROR_SESSION_LOST));
    assert_eq!(client.session.request_exit().err(), Some(sys::Result::ERROR_SESSION_LOST));
    let Client { instance, session, waiter, stream, .. } = client;
    drop((session, waiter, stream));
    control.lose_instance();
    let mut buffer = xr::EventDataBuffer::new();
    assert!(matches!(instance.poll_event(&mut buffer), Ok(Some(xr::Event::InstanceLossPending(_)))));
    assert_eq!(instance.poll_event(&mut buffer).err(), Some(sys::Result::ERROR_INSTANCE_LOST));
    assert_eq!(instance.properties().err(), Some(sys::Result::ERROR_INSTANCE_LOST));
}

#[test]
fn a_motion_that_ends_ends_the_session() {
    struct Short;
    impl PoseProvider for Short {
        fn head(&self, at: Timestamp) -> Tracked {
            Still::default().head(at)
        }
        fn controller(&self, _: Hand, _: Timestamp) -> Controller {
            Controller::absent()
        }
        fn end(&self) -> Option<Timestamp> {
            Some(Timestamp::from_nanos(100_000_000))
        }
    }
    let mut client = Client::begun(Config { motion: Box::new(Short), ..Config::default() });
    let mut frames = 0;
    while client.states.last() != Some(&S::STOPPING) {
        client.frame();
        client.poll();
        frames += 1;
        assert!(frames < 100);
    }
    // The first frame that is displayed after 100 ms, at 11.1 ms each.
    assert_eq!(frames, 10);
}

#[test]
fn a_panic_inside_becomes_an_error_code() {
    struct Broken;
    impl PoseProvider for Broken {
        fn head(&self, at: Timestamp) -> Tracked {
            assert!(at.as_nanos() == 0, "on purpose");
            Tracked::Lost
        }
        fn controller(&self, _: Hand, _: Timestamp) -> Controller {
            Controller::absent()
        }
    }
    let mut client = Client::begun(Config { motion: Box::new(Broken), ..Config::default() });
    let time = client.frame().predicted_display_time;
    use xr::ReferenceSpaceType as R;
    let (view, stage) = (client.space(R::VIEW), client.space(R::STAGE));
    assert_eq!(view.locate(&stage, time).err(), Some(sys::Result::ERROR_RUNTIME_FAILURE));
    client.frame();
}

#[test]
fn rates_masks_and_clocks_of_extensions() {
    let profile = Profile::open("quest3").unwrap();
    let mut client = Client::begun(Config { profile, ..Config::default() });
    assert_eq!(client.session.enumerate_display_refresh_rates().unwrap(), [72.0, 80.0, 90.0, 120.0]);
    assert_eq!(client.session.get_display_refresh_rate().unwrap(), 90.0);
    client.session.request_display_refresh_rate(120.0).unwrap();
    assert_eq!(client.frame().predicted_display_period.as_nanos(), 8_333_333);
    let refused = client.session.request_display_refresh_rate(91.0).err();
    assert_eq!(refused, Some(sys::Result::ERROR_DISPLAY_REFRESH_RATE_UNSUPPORTED_FB));
    let hidden = xr::VisibilityMaskTypeKHR::HIDDEN_TRIANGLE_MESH;
    let mask = client.session.get_visibility_mask_khr(STEREO, 0, hidden).unwrap();
    assert!(mask.indices.len() >= 3);
    assert!(mask.indices.iter().all(|&index| (index as usize) < mask.vertices.len()));
    // The host's clock means now, which the next frame is displayed two periods after.
    let now = client.instance.now().unwrap();
    let next = client.frame().predicted_display_time;
    assert_eq!(next.as_nanos() - now.as_nanos(), 2 * 8_333_333);
}

/// Every function with a handle that is null, invented, of another kind, or destroyed.
#[test]
fn handles_that_are_none_are_refused() {
    let client = Client::begun(Config::default());
    let fp = client.instance.fp();
    let invalid = sys::Result::ERROR_HANDLE_INVALID;
    let space = client.space(xr::ReferenceSpaceType::VIEW);
    let stale = {
        let space = client.space(xr::ReferenceSpaceType::VIEW);
        space.as_raw().into_raw()
    };
    for raw in [0, 1, u64::MAX, stale, space.as_raw().into_raw()] {
        let mut path = sys::Path::NULL;
        let mut count = 0;
        // SAFETY: handles are only looked up; every pointer is null or to a local.
        unsafe {
            let (session, instance) = (sys::Session::from_raw(raw), sys::Instance::from_raw(raw));
            let (swapchain, action_set) = (sys::Swapchain::from_raw(raw), sys::ActionSet::from_raw(raw));
            assert_eq!((fp.begin_session)(session, std::ptr::null()), invalid);
            assert_eq!((fp.end_session)(session), invalid);
            assert_eq!((fp.destroy_session)(session), invalid);
            assert_eq!((fp.begin_frame)(session, std::ptr::null()), invalid);
            assert_eq!((fp.wait_frame)(session, std::ptr::null(), std::ptr::null_mut()), invalid);
            assert_eq!((fp.sync_actions)(session, std::ptr::null()), invalid);
            assert_eq!(
                (fp.enumerate_swapchain_formats)(session, 0, &mut count, std::ptr::null_mut()),
                invalid
            );
            assert_eq!((fp.string_to_path)(instance, c"/user".as_ptr(), &mut path), invalid);
            assert_eq!((fp.poll_event)(instance, std::ptr::null_mut()), invalid);
            assert_eq!((fp.destroy_instance)(instance), invalid);
            assert_eq!((fp.destroy_swapchain)(swapchain), invalid);
            assert_eq!((fp.acquire_swapchain_image)(swapchain, std::ptr::null(), &mut count), invalid);
            assert_eq!((fp.destroy_action_set)(action_set), invalid);
            assert_eq!((fp.create_action)(action_set, std::ptr::null(), std::ptr::null_mut()), invalid);
            assert_eq!((fp.destroy_action)(sys::Action::from_raw(raw)), invalid);
        }
    }
    // SAFETY: as above.
    unsafe {
        assert_eq!((fp.destroy_space)(sys::Space::from_raw(stale)), invalid);
        let mut wrong = sys::SpaceLocation::out(std::ptr::null_mut()).assume_init();
        wrong.ty = sys::StructureType::VIEW;
        let time = sys::Time::from_nanos(1);
        let code = (fp.locate_space)(space.as_raw(), space.as_raw(), time, &mut wrong);
        assert_eq!(code, sys::Result::ERROR_VALIDATION_FAILURE);
    }
}

#[test]
fn arrays_come_in_two_calls() {
    let client = Client::begun(Config::default());
    let fp = client.instance.fp();
    let path = client.instance.string_to_path("/user/hand/left").unwrap();
    let mut text = [1; 32];
    let mut count = 0;
    // SAFETY: capacities are at most the length of the array.
    let mut ask = |capacity, count: *mut u32| unsafe {
        (fp.path_to_string)(client.instance.as_raw(), path, capacity, count, text.as_mut_ptr())
    };
    assert_eq!(ask(0, &mut count), sys::Result::SUCCESS);
    assert_eq!(count, 16);
    assert_eq!(ask(15, &mut count), sys::Result::ERROR_SIZE_INSUFFICIENT);
    assert_eq!(count, 16);
    assert_eq!(ask(32, &mut count), sys::Result::SUCCESS);
    assert_eq!(ask(0, std::ptr::null_mut()), sys::Result::ERROR_VALIDATION_FAILURE);
    assert_eq!((text[0], text[15]), (b'/' as _, 0));
    assert_eq!(client.instance.path_to_string(path).unwrap(), "/user/hand/left");
    let names = [
        (sys::Result::ERROR_HANDLE_INVALID, "XR_ERROR_HANDLE_INVALID"),
        (sys::Result::from_raw(-123_456), "XR_UNKNOWN_FAILURE_-123456"),
        (sys::Result::from_raw(123_456), "XR_UNKNOWN_SUCCESS_123456"),
    ];
    for (code, name) in names {
        let mut text = [0; sys::MAX_RESULT_STRING_SIZE];
        // SAFETY: the array has the length that the function demands.
        unsafe { (fp.result_to_string)(client.instance.as_raw(), code, text.as_mut_ptr()) };
        let text: Vec<u8> = text.iter().take_while(|&&c| c != 0).map(|&c| c as u8).collect();
        assert_eq!(String::from_utf8(text).unwrap(), name);
    }
}
