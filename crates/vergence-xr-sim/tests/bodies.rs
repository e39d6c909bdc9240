//! The joints of the hands and the gaze through the `openxr` crate.
#![allow(clippy::unwrap_used, reason = "a test fails where it cannot go on")]
#![allow(unsafe_code, reason = "the runtime is called through its C interface")]

use std::path::Path;

use openxr as xr;
use vergence_sense::{HandJoint, JOINTS_PER_HAND};
use vergence_time::Timestamp;
use vergence_xr_sim::{Config, PoseProvider, Profile, Runtime, Script, get_instance_proc_addr};
use xr::SpaceLocationFlags as F;
use xr::sys;
use xr::sys::Handle as _;

const SCRIPT: &str = r#"
    at-end = "hold"
    [[head]]
    time = "0 s"
    position = ["0 m", "1.6 m", "0 m"]
    [[gaze]]
    time = "0 s"
    turned = { yaw = "90 deg" }
    [[right-hand]]
    time = "0 s"
    position = ["0.2 m", "1.2 m", "-0.4 m"]
    curl = 0.0
    [[right-hand]]
    time = "10 s"
    position = ["0.2 m", "2.2 m", "-0.4 m"]
    [[left]]
    time = "0 s"
    connected = false
"#;

fn script() -> Script {
    Script::parse(Path::new("bodies.toml"), SCRIPT).unwrap()
}

fn instance(profile: Profile) -> (xr::Instance, xr::SystemId) {
    Runtime::configure(Config { profile, motion: Box::new(script()), ..Config::default() });
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
    extensions.ext_hand_tracking = true;
    extensions.ext_eye_gaze_interaction = true;
    let instance = entry.create_instance(&info, &extensions, &[], &()).unwrap();
    let system = instance.system(xr::FormFactor::HEAD_MOUNTED_DISPLAY).unwrap();
    (instance, system)
}

struct Client {
    instance: xr::Instance,
    session: xr::Session<xr::Headless>,
    waiter: xr::FrameWaiter,
    stream: xr::FrameStream<xr::Headless>,
}

impl Client {
    fn new() -> Self {
        let (instance, system) = instance(Profile::default());
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

    fn local(&self) -> xr::Space {
        self.session.create_reference_space(xr::ReferenceSpaceType::LOCAL, xr::Posef::IDENTITY).unwrap()
    }
}

fn all() -> F {
    F::ORIENTATION_VALID | F::POSITION_VALID | F::ORIENTATION_TRACKED | F::POSITION_TRACKED
}

#[test]
fn joints_are_where_the_script_has_the_hand() {
    let mut client = Client::new();
    let local = client.local();
    let [left, right] =
        [xr::Hand::LEFT, xr::Hand::RIGHT].map(|hand| client.session.create_hand_tracker(hand).unwrap());
    for _ in 0..3 {
        let time = client.frame();
        let located = local.locate_hand_joints(&right, time).unwrap().unwrap();
        // Motion time 0 is when the session began, at 1 s; LOCAL is where the head was then.
        let at = Timestamp::from_nanos(time.as_nanos() - 1_000_000_000);
        let truth = script().hand(vergence_xr_sim::Hand::Right, at).unwrap();
        for (joint, (pose, radius_m)) in located.iter().zip(&truth.joints) {
            assert_eq!((joint.location_flags, joint.radius), (all(), *radius_m as f32));
            let expected = pose.translation.vector - nalgebra::Vector3::new(0.0, 1.6, 0.0);
            let found = joint.pose.position;
            let found = nalgebra::Vector3::new(found.x, found.y, found.z).cast::<f64>();
            assert!((found - expected).norm() < 1e-6, "{found} {expected}");
        }
        let palm = located[HandJoint::Palm as usize].pose.position;
        assert!((f64::from(palm.x) - 0.2).abs() < 1e-6);
        assert!(local.locate_hand_joints(&left, time).unwrap().is_none(), "nothing is in the left hand");
        // How fast: the script lifts the hand by 0.1 m/s.
        let (_, velocities) = local.relate_hand_joints(&right, time).unwrap().unwrap();
        let tip = velocities[HandJoint::IndexTip as usize];
        assert!((tip.linear_velocity.y - 0.1).abs() < 1e-4, "{:?}", tip.linear_velocity);
        assert!(tip.linear_velocity.x.abs() < 1e-5 && tip.angular_velocity.x.abs() < 1e-4);
    }
}

#[test]
fn wrong_arguments_are_refused() {
    let mut client = Client::new();
    let (local, time) = (client.local(), client.frame());
    let tracker = client.session.create_hand_tracker(xr::Hand::LEFT).unwrap();
    let hand = *client.instance.exts().ext_hand_tracking.as_ref().unwrap();
    let mut joints =
        [sys::HandJointLocationEXT { location_flags: F::EMPTY, pose: xr::Posef::IDENTITY, radius: 0.0 };
            JOINTS_PER_HAND];
    let mut locate = |time: xr::Time, base: sys::Space, count: u32| {
        let info = sys::HandJointsLocateInfoEXT {
            ty: sys::HandJointsLocateInfoEXT::TYPE,
            next: std::ptr::null(),
            base_space: base,
            time,
        };
        let mut locations = sys::HandJointLocationsEXT {
            ty: sys::HandJointLocationsEXT::TYPE,
            next: std::ptr::null_mut(),
            is_active: sys::FALSE,
            joint_count: count,
            joint_locations: joints.as_mut_ptr(),
        };
        // SAFETY: the structures live and the array has room for all joints.
        unsafe { (hand.locate_hand_joints)(tracker.as_raw(), &info, &mut locations) }
    };
    assert_eq!(locate(time, local.as_raw(), 26), sys::Result::SUCCESS);
    assert_eq!(locate(time, local.as_raw(), 25), sys::Result::ERROR_VALIDATION_FAILURE);
    assert_eq!(locate(xr::Time::from_nanos(0), local.as_raw(), 26), sys::Result::ERROR_TIME_INVALID);
    assert_eq!(locate(time, sys::Space::NULL, 26), sys::Result::ERROR_HANDLE_INVALID);
    let create = |hand_of: sys::HandEXT, set: sys::HandJointSetEXT| {
        let info = sys::HandTrackerCreateInfoEXT {
            ty: sys::HandTrackerCreateInfoEXT::TYPE,
            next: std::ptr::null(),
            hand: hand_of,
            hand_joint_set: set,
        };
        let mut out = sys::HandTrackerEXT::NULL;
        // SAFETY: the structure lives and the place is ours.
        unsafe { (hand.create_hand_tracker)(client.session.as_raw(), &info, &mut out) }
    };
    let refused = sys::Result::ERROR_VALIDATION_FAILURE;
    assert_eq!(create(sys::HandEXT::from_raw(7), sys::HandJointSetEXT::DEFAULT), refused);
    assert_eq!(create(sys::HandEXT::LEFT, sys::HandJointSetEXT::from_raw(9)), refused);
    // A tracker that is gone is not there.
    let raw = tracker.as_raw();
    drop(tracker);
    // SAFETY: what is destroyed twice is refused by its handle.
    assert_eq!(unsafe { (hand.destroy_hand_tracker)(raw) }, sys::Result::ERROR_HANDLE_INVALID);
}

#[test]
fn what_a_headset_does_not_see_it_does_not_offer() {
    for (name, hands) in [("default", true), ("quest3", true), ("index", false)] {
        let (instance, system) = instance(Profile::open(name).unwrap());
        assert_eq!(instance.supports_hand_tracking(system), Ok(hands), "{name}");
        // SAFETY: a headless session has no graphics binding.
        let (session, ..) = unsafe {
            instance.create_session::<xr::Headless>(system, &xr::headless::SessionCreateInfo {}).unwrap()
        };
        let refused = session.create_hand_tracker(xr::Hand::LEFT).err();
        assert_eq!(refused, (!hands).then_some(sys::Result::ERROR_FEATURE_UNSUPPORTED), "{name}");
    }
}

#[test]
fn the_gaze_is_an_action_of_the_eyes() {
    let mut client = Client::new();
    let instance = client.instance.clone();
    let path = |text: &str| instance.string_to_path(text).unwrap();
    let (eyes, profile) = (path("/user/eyes_ext"), path("/interaction_profiles/ext/eye_gaze_interaction"));
    let set = instance.create_action_set("look", "Look", 0).unwrap();
    let gaze = set.create_action::<xr::Posef>("gaze", "Gaze", &[]).unwrap();
    let binding = || xr::Binding::new(&gaze, path("/user/eyes_ext/input/gaze_ext/pose"));
    // What hands do, eyes do not.
    let wrong = xr::Binding::new(&gaze, path("/user/hand/left/input/aim/pose"));
    let refused = instance.suggest_interaction_profile_bindings(profile, &[wrong]);
    assert_eq!(refused, Err(sys::Result::ERROR_PATH_UNSUPPORTED));
    instance.suggest_interaction_profile_bindings(profile, &[binding()]).unwrap();
    client.session.attach_action_sets(&[&set]).unwrap();
    let space = gaze.create_space(&client.session, xr::Path::NULL, xr::Posef::IDENTITY).unwrap();
    let local = client.local();
    let time = client.frame();
    assert!(!gaze.is_active(&client.session, xr::Path::NULL).unwrap(), "nothing was synchronized");
    client.session.sync_actions(&[xr::ActiveActionSet::new(&set)]).unwrap();
    assert!(gaze.is_active(&client.session, xr::Path::NULL).unwrap());
    assert_eq!(client.session.current_interaction_profile(eyes), Ok(profile));
    let located = space.locate(&local, time).unwrap();
    let (p, q) = (located.pose.position, located.pose.orientation);
    assert_eq!(located.location_flags, all());
    assert!(p.x.hypot(p.y).hypot(p.z) < 1e-6, "between the eyes: {p:?}");
    let half = std::f32::consts::FRAC_1_SQRT_2;
    assert!((q.y.abs() - half).abs() < 1e-6 && (q.w.abs() - half).abs() < 1e-6, "to the left: {q:?}");
    let said = client.session.input_source_localized_name(
        path("/user/eyes_ext/input/gaze_ext/pose"),
        xr::InputSourceLocalizedNameFlags::USER_PATH,
    );
    assert_eq!(said.unwrap(), "Eyes");
}

/// Without the extension there is no such profile.
#[test]
fn without_the_extension_eyes_are_unknown() {
    Runtime::configure(Config::default());
    // SAFETY: the runtime follows the specification.
    let entry = unsafe { xr::Entry::from_get_instance_proc_addr(get_instance_proc_addr, &()).unwrap() };
    let info = xr::ApplicationInfo {
        application_name: "test",
        application_version: 1,
        engine_name: "",
        engine_version: 0,
        api_version: xr::Version::new(1, 0, 0),
    };
    let instance = entry.create_instance(&info, &xr::ExtensionSet::default(), &[], &()).unwrap();
    let path = |text: &str| instance.string_to_path(text).unwrap();
    let set = instance.create_action_set("look", "Look", 0).unwrap();
    let gaze = set.create_action::<xr::Posef>("gaze", "Gaze", &[]).unwrap();
    let binding = xr::Binding::new(&gaze, path("/user/eyes_ext/input/gaze_ext/pose"));
    let profile = path("/interaction_profiles/ext/eye_gaze_interaction");
    let refused = instance.suggest_interaction_profile_bindings(profile, &[binding]);
    assert_eq!(refused, Err(sys::Result::ERROR_PATH_UNSUPPORTED));
}
