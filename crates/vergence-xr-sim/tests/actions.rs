//! Actions through the `openxr` crate: bindings, states from the pose provider, haptics, names.
#![allow(clippy::unwrap_used, reason = "a test fails where it cannot go on")]
#![allow(unsafe_code, reason = "the runtime is called through its C interface")]

use openxr as xr;
use vergence_time::Timestamp;
use vergence_xr_sim::{
    Config, Control, Controller, Hand, PoseProvider, Runtime, Still, Tracked, get_instance_proc_addr,
};
use xr::sys;

type Rigid = vergence_geom::Rigid;

/// A right controller that goes up, whose trigger is pulled slowly; no left one.
struct Right;

impl PoseProvider for Right {
    fn head(&self, at: Timestamp) -> Tracked {
        Still::default().head(at)
    }

    fn controller(&self, hand: Hand, at: Timestamp) -> Controller {
        let t = at.as_nanos() as f64 * 1e-9;
        if hand == Hand::Left {
            return Controller::absent();
        }
        let grip = Rigid::translation(0.2, 1.0 + t, -0.4);
        let aim = grip * Rigid::translation(0.0, 0.0, -0.1);
        let mut controller = Controller::idle(Tracked::Seen(grip), Tracked::Seen(aim));
        controller.trigger = (4.0 * t).min(1.0) as f32;
        controller.stick = [0.25, -0.5];
        controller
    }
}

struct Client {
    instance: xr::Instance,
    session: xr::Session<xr::Headless>,
    waiter: xr::FrameWaiter,
    stream: xr::FrameStream<xr::Headless>,
}

impl Client {
    fn new(config: Config) -> Self {
        Runtime::configure(config);
        // SAFETY: the runtime follows the specification.
        let entry = unsafe { xr::Entry::from_get_instance_proc_addr(get_instance_proc_addr, &()).unwrap() };
        let info = xr::ApplicationInfo {
            application_name: "test",
            application_version: 1,
            engine_name: "",
            engine_version: 0,
            api_version: xr::Version::new(1, 0, 0),
        };
        let mut extensions = xr::ExtensionSet::default();
        extensions.mnd_headless = true;
        let instance = entry.create_instance(&info, &extensions, &[], &()).unwrap();
        let system = instance.system(xr::FormFactor::HEAD_MOUNTED_DISPLAY).unwrap();
        // SAFETY: a headless session has no graphics binding.
        let (session, waiter, stream) = unsafe {
            instance.create_session::<xr::Headless>(system, &xr::headless::SessionCreateInfo {}).unwrap()
        };
        session.begin(xr::ViewConfigurationType::PRIMARY_STEREO).unwrap();
        Self { instance, session, waiter, stream }
    }

    fn frame(&mut self) -> xr::Time {
        let state = self.waiter.wait().unwrap();
        self.stream.begin().unwrap();
        self.stream.end(state.predicted_display_time, xr::EnvironmentBlendMode::OPAQUE, &[]).unwrap();
        state.predicted_display_time
    }

    fn path(&self, path: &str) -> xr::Path {
        self.instance.string_to_path(path).unwrap()
    }
}

const TOUCH: &str = "/interaction_profiles/oculus/touch_controller";
const SIMPLE: &str = "/interaction_profiles/khr/simple_controller";
const TRIGGER: &str = "/user/hand/right/input/trigger/value";

#[test]
fn states_come_from_the_pose_provider() {
    let control = Control::default();
    let config = Config { motion: Box::new(Right), control: control.clone(), ..Config::default() };
    let mut client = Client::new(config);
    let [left, right] = ["/user/hand/left", "/user/hand/right"].map(|path| client.path(path));
    let set = client.instance.create_action_set("play", "Play", 0).unwrap();
    let hands = [left, right];
    let grab = set.create_action::<bool>("grab", "Grab", &hands).unwrap();
    let pull = set.create_action::<f32>("pull", "Pull", &[]).unwrap();
    let walk = set.create_action::<xr::Vector2f>("walk", "Walk", &[]).unwrap();
    let grip = set.create_action::<xr::Posef>("grip", "Grip", &hands).unwrap();
    let buzz = set.create_action::<xr::Haptic>("buzz", "Buzz", &hands).unwrap();
    let bindings = [
        xr::Binding::new(&grab, client.path("/user/hand/left/input/trigger/value")),
        xr::Binding::new(&grab, client.path("/user/hand/right/input/trigger")),
        xr::Binding::new(&pull, client.path(TRIGGER)),
        xr::Binding::new(&walk, client.path("/user/hand/right/input/thumbstick")),
        xr::Binding::new(&grip, client.path("/user/hand/left/input/grip/pose")),
        xr::Binding::new(&grip, client.path("/user/hand/right/input/grip/pose")),
        xr::Binding::new(&buzz, client.path("/user/hand/right/output/haptic")),
    ];
    client.instance.suggest_interaction_profile_bindings(client.path(TOUCH), &bindings).unwrap();
    let early = grab.state(&client.session, xr::Path::NULL);
    assert_eq!(early.err(), Some(sys::Result::ERROR_ACTIONSET_NOT_ATTACHED));
    client.session.attach_action_sets(&[&set]).unwrap();
    let again = client.session.attach_action_sets(&[&set]);
    assert_eq!(again.err(), Some(sys::Result::ERROR_ACTIONSETS_ALREADY_ATTACHED));
    let late = set.create_action::<bool>("late", "Late", &[]);
    assert_eq!(late.err(), Some(sys::Result::ERROR_ACTIONSETS_ALREADY_ATTACHED));
    assert_eq!(client.session.current_interaction_profile(right).unwrap(), xr::Path::NULL);

    let space = grip.create_space(&client.session, right, xr::Posef::IDENTITY).unwrap();
    let stage =
        client.session.create_reference_space(xr::ReferenceSpaceType::STAGE, xr::Posef::IDENTITY).unwrap();
    let mut clicks = Vec::new();
    for frame in 0..30 {
        let time = client.frame();
        client.session.sync_actions(&[xr::ActiveActionSet::new(&set)]).unwrap();
        let state = pull.state(&client.session, xr::Path::NULL).unwrap();
        assert!(state.is_active);
        // Actions are as of the display of the frame that was begun.
        let shown = (time.as_nanos() - 1_000_000_000) as f64 * 1e-9;
        assert_eq!(state.current_state, (4.0 * shown).min(1.0) as f32, "{frame}");
        let pressed = grab.state(&client.session, right).unwrap();
        assert_eq!(pressed.current_state, state.current_state >= 0.5);
        if pressed.changed_since_last_sync {
            clicks.push((frame, pressed.current_state));
        }
        assert!(!grab.state(&client.session, left).unwrap().is_active);
        let stick = walk.state(&client.session, xr::Path::NULL).unwrap().current_state;
        assert_eq!((stick.x, stick.y), (0.25, -0.5));
        let location = space.locate(&stage, time).unwrap();
        assert!(location.location_flags.contains(xr::SpaceLocationFlags::POSITION_TRACKED));
        assert!((f64::from(location.pose.position.y) - (1.0 + shown)).abs() < 1e-6);
    }
    // 4 t reaches one half at 125 ms: frame 11 is shown at 133 ms.
    assert_eq!(clicks, [(11, true)]);
    assert_eq!(client.session.current_interaction_profile(right).unwrap(), client.path(TOUCH));
    assert_eq!(client.session.current_interaction_profile(left).unwrap(), xr::Path::NULL);

    let pulse = xr::HapticVibration::new()
        .amplitude(0.5)
        .frequency(100.0)
        .duration(xr::Duration::from_nanos(1_000_000));
    buzz.apply_feedback(&client.session, right, &pulse).unwrap();
    buzz.stop_feedback(&client.session, right).unwrap();
    let felt = control.haptics();
    assert_eq!(felt.len(), 2);
    assert_eq!((felt[0].hand, felt[0].amplitude, felt[1].amplitude), (Hand::Right, 0.5, 0.0));
    let loud = xr::HapticVibration::new().amplitude(2.0).duration(xr::Duration::MIN_HAPTIC);
    let refused = buzz.apply_feedback(&client.session, right, &loud);
    assert_eq!(refused.err(), Some(sys::Result::ERROR_VALIDATION_FAILURE));
}

#[test]
fn the_simple_controller_stands_in_where_nothing_else_is_suggested() {
    let mut client = Client::new(Config { motion: Box::new(Right), ..Config::default() });
    let set = client.instance.create_action_set("play", "Play", 0).unwrap();
    let select = set.create_action::<bool>("select", "Select", &[]).unwrap();
    let binding = xr::Binding::new(&select, client.path("/user/hand/right/input/select/click"));
    client.instance.suggest_interaction_profile_bindings(client.path(SIMPLE), &[binding]).unwrap();
    client.session.attach_action_sets(&[&set]).unwrap();
    for _ in 0..20 {
        client.frame();
    }
    client.session.sync_actions(&[(&set).into()]).unwrap();
    assert!(select.state(&client.session, xr::Path::NULL).unwrap().current_state);
    let profile = client.session.current_interaction_profile(client.path("/user/hand/right")).unwrap();
    assert_eq!(profile, client.path(SIMPLE));
}

#[test]
fn a_set_of_higher_priority_keeps_an_input_to_itself() {
    let mut client = Client::new(Config { motion: Box::new(Right), ..Config::default() });
    let low = client.instance.create_action_set("low", "Low", 1).unwrap();
    let high = client.instance.create_action_set("high", "High", 2).unwrap();
    let [a, b] = [&low, &high].map(|set| set.create_action::<f32>("pull", "Pull", &[]).unwrap());
    let stick = low.create_action::<f32>("stick", "Stick", &[]).unwrap();
    let bindings = [
        xr::Binding::new(&a, client.path(TRIGGER)),
        xr::Binding::new(&b, client.path(TRIGGER)),
        xr::Binding::new(&stick, client.path("/user/hand/right/input/thumbstick/x")),
    ];
    client.instance.suggest_interaction_profile_bindings(client.path(TOUCH), &bindings).unwrap();
    client.session.attach_action_sets(&[&low, &high]).unwrap();
    client.frame();
    client.session.sync_actions(&[(&low).into(), (&high).into()]).unwrap();
    let active = |action: &xr::Action<f32>| action.state(&client.session, xr::Path::NULL).unwrap().is_active;
    assert!(!active(&a) && active(&b) && active(&stick));
    client.session.sync_actions(&[(&low).into()]).unwrap();
    assert!(active(&a) && !active(&b));
}

#[test]
fn what_cannot_be_bound_or_named_is_refused() {
    let client = Client::new(Config::default());
    let set = client.instance.create_action_set("play", "Play", 0).unwrap();
    for (name, localized, code) in [
        ("play", "Other", sys::Result::ERROR_NAME_DUPLICATED),
        ("other", "Play", sys::Result::ERROR_LOCALIZED_NAME_DUPLICATED),
        ("", "Other", sys::Result::ERROR_NAME_INVALID),
        ("other", "", sys::Result::ERROR_LOCALIZED_NAME_INVALID),
        ("Other", "Other", sys::Result::ERROR_PATH_FORMAT_INVALID),
    ] {
        let made = client.instance.create_action_set(name, localized, 0);
        assert_eq!(made.err(), Some(code), "{name} {localized}");
    }
    let action = set.create_action::<bool>("a", "A", &[]).unwrap();
    let elsewhere = set.create_action::<bool>("b", "B", &[client.path("/user/elsewhere")]);
    assert_eq!(elsewhere.err(), Some(sys::Result::ERROR_PATH_UNSUPPORTED));
    let suggest = |profile: &str, binding: &str| {
        let binding = xr::Binding::new(&action, client.path(binding));
        client.instance.suggest_interaction_profile_bindings(client.path(profile), &[binding]).err()
    };
    let unsupported = Some(sys::Result::ERROR_PATH_UNSUPPORTED);
    let x = "/user/hand/left/input/x/click";
    assert_eq!(suggest("/interaction_profiles/nobody/knows", x), unsupported);
    assert_eq!(suggest(TOUCH, "/user/hand/left/input/a/click"), unsupported);
    // Came with OpenXR 1.1, and this instance is of 1.0.
    assert_eq!(suggest("/interaction_profiles/meta/touch_plus_controller", x), unsupported);
    assert_eq!(suggest(TOUCH, x), None);
    client.session.attach_action_sets(&[&set]).unwrap();
    assert_eq!(suggest(TOUCH, x), Some(sys::Result::ERROR_ACTIONSETS_ALREADY_ATTACHED));
    let foreign = action.state(&client.session, client.path("/user/hand/left"));
    assert_eq!(foreign.err(), Some(sys::Result::ERROR_PATH_UNSUPPORTED));
}
