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

/// Both hands: the left trigger is at 0.25, the right one at 0.75 from the tenth of a second on; sticks point apart.
struct Both;

/// When the right trigger of [`Both`] is pulled, seconds of motion time.
const PULLED_S: f64 = 0.1;

impl PoseProvider for Both {
    fn head(&self, at: Timestamp) -> Tracked {
        Still::default().head(at)
    }

    fn controller(&self, hand: Hand, at: Timestamp) -> Controller {
        let t = at.as_nanos() as f64 * 1e-9;
        // Turns about the vertical at 1 rad/s, half a metre from the axis.
        let stage_from_grip =
            Rigid::rotation(nalgebra::Vector3::new(0.0, t, 0.0)) * Rigid::translation(0.0, 1.0, -0.5);
        let mut controller = Controller::idle(Tracked::Seen(stage_from_grip), Tracked::Seen(stage_from_grip));
        if hand == Hand::Left {
            controller.trigger = 0.25;
            controller.stick = [-0.2, 0.1];
        } else {
            controller.trigger = if t >= PULLED_S { 0.75 } else { 0.0 };
            controller.stick = [0.1, -0.9];
        }
        controller
    }
}

/// Actions of a game that do not care for the hand, and its sets.
struct Game {
    set: xr::ActionSet,
    click: xr::Action<bool>,
    pull: xr::Action<f32>,
    walk: xr::Action<xr::Vector2f>,
    grip: xr::Action<xr::Posef>,
    hands: [xr::Path; 2],
}

impl Game {
    fn attached(client: &Client) -> Self {
        let hands = ["/user/hand/left", "/user/hand/right"].map(|path| client.path(path));
        let set = client.instance.create_action_set("game", "Game", 0).unwrap();
        let click = set.create_action::<bool>("click", "Click", &hands).unwrap();
        let pull = set.create_action::<f32>("pull", "Pull", &hands).unwrap();
        let walk = set.create_action::<xr::Vector2f>("walk", "Walk", &hands).unwrap();
        let grip = set.create_action::<xr::Posef>("grip", "Grip", &hands).unwrap();
        let mut bindings = Vec::new();
        for hand in ["left", "right"] {
            let path = |end: &str| client.path(&format!("/user/hand/{hand}/input/{end}"));
            bindings.push(xr::Binding::new(&click, path("trigger/value")));
            bindings.push(xr::Binding::new(&pull, path("trigger/value")));
            bindings.push(xr::Binding::new(&walk, path("thumbstick")));
            bindings.push(xr::Binding::new(&grip, path("grip/pose")));
        }
        client.instance.suggest_interaction_profile_bindings(client.path(TOUCH), &bindings).unwrap();
        client.session.attach_action_sets(&[&set]).unwrap();
        Self { set, click, pull, walk, grip, hands }
    }
}

/// Of several inputs the specification takes OR for booleans, the largest amount for numbers, the longest for vectors.
#[test]
fn an_action_without_a_hand_is_read_from_both() {
    let mut client = Client::new(Config { motion: Box::new(Both), ..Config::default() });
    let game = Game::attached(&client);
    for _ in 0..20 {
        client.frame();
    }
    client.session.sync_actions(&[(&game.set).into()]).unwrap();
    let any = xr::Path::NULL;
    assert!(game.click.state(&client.session, any).unwrap().current_state);
    assert_eq!(game.pull.state(&client.session, any).unwrap().current_state, 0.75);
    let stick = game.walk.state(&client.session, any).unwrap().current_state;
    assert_eq!((stick.x, stick.y), (0.1, -0.9));
    assert!(game.grip.is_active(&client.session, any).unwrap());
    let [left, right] = game.hands;
    assert!(!game.click.state(&client.session, left).unwrap().current_state);
    assert!(game.click.state(&client.session, right).unwrap().current_state);
    assert_eq!(game.pull.state(&client.session, left).unwrap().current_state, 0.25);
}

/// A change is said by the sync that sees it and by no later one; its time stays.
#[test]
fn a_change_is_said_once_and_its_time_stays() {
    let mut client = Client::new(Config { motion: Box::new(Both), ..Config::default() });
    let game = Game::attached(&client);
    let right = game.hands[1];
    let mut changes = Vec::new();
    let mut times = Vec::new();
    for frame in 0..20 {
        let time = client.frame();
        client.session.sync_actions(&[(&game.set).into()]).unwrap();
        let state = game.pull.state(&client.session, right).unwrap();
        // Asked twice, it answers the same: only a sync changes anything.
        let again = game.pull.state(&client.session, right).unwrap();
        assert_eq!(state.changed_since_last_sync, again.changed_since_last_sync);
        if state.changed_since_last_sync {
            changes.push((frame, state.current_state));
        }
        if state.current_state > 0.5 {
            times.push(state.last_change_time.as_nanos());
            assert!(state.last_change_time.as_nanos() <= time.as_nanos());
        }
    }
    assert_eq!(changes.len(), 1, "{changes:?}");
    assert_eq!(changes[0].1, 0.75);
    assert!(times.len() > 5 && times.iter().all(|time| *time == times[0]), "{times:?}");
}

/// What a sync leaves out is inactive until a sync names it again.
#[test]
fn only_what_a_sync_names_is_active() {
    let mut client = Client::new(Config { motion: Box::new(Both), ..Config::default() });
    let game = Game::attached(&client);
    let other = client.instance.create_action_set("other", "Other", 0).unwrap();
    for _ in 0..20 {
        client.frame();
    }
    let [left, right] = game.hands;
    let active = |hand| game.pull.state(&client.session, hand).unwrap().is_active;
    assert!(!active(left) && !active(right), "nothing was synced");
    client.session.sync_actions(&[xr::ActiveActionSet::with_subaction(&game.set, left)]).unwrap();
    assert!(active(left) && !active(right));
    client.session.sync_actions(&[(&game.set).into()]).unwrap();
    assert!(active(left) && active(right));
    client.session.sync_actions(&[]).unwrap();
    let state = game.pull.state(&client.session, right).unwrap();
    assert!(!state.is_active && !state.changed_since_last_sync && state.current_state == 0.0);
    let foreign = client.session.sync_actions(&[(&other).into()]);
    assert_eq!(foreign.err(), Some(sys::Result::ERROR_ACTIONSET_NOT_ATTACHED));
}

/// Two sets of one priority share an input; a higher one takes it only while it is synced.
#[test]
fn sets_of_one_priority_share_an_input() {
    let mut client = Client::new(Config { motion: Box::new(Right), ..Config::default() });
    let sets = [("a", "A"), ("b", "B")].map(|(name, shown)| {
        let set = client.instance.create_action_set(name, shown, 5).unwrap();
        let action = set.create_action::<f32>("pull", "Pull", &[]).unwrap();
        (set, action)
    });
    let bindings: Vec<_> =
        sets.iter().map(|(_, action)| xr::Binding::new(action, client.path(TRIGGER))).collect();
    client.instance.suggest_interaction_profile_bindings(client.path(TOUCH), &bindings).unwrap();
    client.session.attach_action_sets(&[&sets[0].0, &sets[1].0]).unwrap();
    client.frame();
    client.session.sync_actions(&[(&sets[0].0).into(), (&sets[1].0).into()]).unwrap();
    for (_, action) in &sets {
        assert!(action.state(&client.session, xr::Path::NULL).unwrap().is_active);
    }
}

/// A menu of the system has the input: nothing is active, and nobody is told that a button was let go.
#[test]
fn without_focus_nothing_is_active() {
    let control = Control::default();
    let config = Config { motion: Box::new(Both), control: control.clone(), ..Config::default() };
    let mut client = Client::new(config);
    let game = Game::attached(&client);
    for _ in 0..20 {
        client.frame();
    }
    client.session.sync_actions(&[(&game.set).into()]).unwrap();
    assert!(game.click.state(&client.session, xr::Path::NULL).unwrap().current_state);
    control.set_presence(vergence_xr_sim::Presence::Visible);
    let mut states = Vec::new();
    let mut buffer = xr::EventDataBuffer::new();
    for _ in 0..3 {
        client.frame();
        while let Some(event) = client.instance.poll_event(&mut buffer).unwrap() {
            if let xr::Event::SessionStateChanged(event) = event {
                states.push(event.state());
            }
        }
    }
    assert_eq!(states.last(), Some(&xr::SessionState::VISIBLE), "{states:?}");
    // Also a qualified success is none to the crate's Result.
    client.session.sync_actions(&[(&game.set).into()]).unwrap();
    for hand in [xr::Path::NULL, game.hands[0], game.hands[1]] {
        let state = game.click.state(&client.session, hand).unwrap();
        assert!(!state.is_active && !state.current_state && !state.changed_since_last_sync);
        assert!(!game.grip.is_active(&client.session, hand).unwrap());
    }
}

/// A space at a distance from a turning hand moves, too: v = ω × r.
#[test]
fn a_space_on_a_turning_hand_moves_as_its_place_says() {
    let mut client = Client::new(Config { motion: Box::new(Both), ..Config::default() });
    let game = Game::attached(&client);
    let mut pose = xr::Posef::IDENTITY;
    pose.position.z = -0.5;
    let tip = game.grip.create_space(&client.session, game.hands[1], pose).unwrap();
    let stage =
        client.session.create_reference_space(xr::ReferenceSpaceType::STAGE, xr::Posef::IDENTITY).unwrap();
    let time = (0..5).map(|_| client.frame()).last().unwrap();
    client.session.sync_actions(&[(&game.set).into()]).unwrap();
    let (location, velocity) = tip.relate(&stage, time).unwrap();
    let (p, v, w) = (location.pose.position, velocity.linear_velocity, velocity.angular_velocity);
    assert!((w.x.abs() + w.z.abs()) < 1e-3 && (w.y - 1.0).abs() < 1e-3, "{w:?}");
    // One metre from the axis: ω × r = (ω_y z, 0, −ω_y x).
    assert!((p.x.hypot(p.z) - 1.0).abs() < 1e-5, "{p:?}");
    assert!((v.x - p.z).abs() < 2e-3 && v.y.abs() < 1e-3 && (v.z + p.x).abs() < 2e-3, "{v:?} {p:?}");
    // And back: the stage as the tip sees it.
    let back = stage.locate(&tip, time).unwrap().pose;
    let there = pose_of(&location.pose);
    let identity = there * pose_of(&back);
    assert!(identity.translation.vector.norm() < 1e-5 && identity.rotation.angle() < 1e-5);
}

fn pose_of(pose: &xr::Posef) -> Rigid {
    let (p, q) = (pose.position, pose.orientation);
    let rotation =
        nalgebra::UnitQuaternion::new_normalize(nalgebra::Quaternion::new(q.w, q.x, q.y, q.z).cast::<f64>());
    Rigid::from_parts(nalgebra::Vector3::new(p.x, p.y, p.z).cast::<f64>().into(), rotation)
}
