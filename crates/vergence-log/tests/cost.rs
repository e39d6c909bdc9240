//! What recording costs the thread that records: no allocation.
#![allow(unsafe_code, reason = "counting allocations takes an allocator")]
#![allow(clippy::unwrap_used, reason = "a test stops where something is not as expected")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use vergence_log::{Header, Options, Recorder, StreamDesc, Times};
use vergence_sense::{
    Axis, Button, Event, FrameTiming, Haptic, JOINTS_PER_HAND, RawJoint, RawJoints, RawLocation, RawPose,
    RawView, RawViews, Scalar, Validity, Vector2,
};
use vergence_time::{Span, Timestamp};

/// Counts what this thread asks for; the writer's thread may ask for what it likes.
struct Counting;

thread_local! {
    static ASKED: Cell<u64> = const { Cell::new(0) };
}

// SAFETY: every call is handed to the system's allocator as it came.
unsafe impl GlobalAlloc for Counting {
    // SAFETY: the caller keeps the promises of `alloc`.
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ASKED.set(ASKED.get() + 1);
        // SAFETY: as promised to us.
        unsafe { System.alloc(layout) }
    }

    // SAFETY: the caller keeps the promises of `dealloc`.
    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        // SAFETY: as promised to us.
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn a_frame_asks_for_no_memory() {
    let dir = tempfile::TempDir::new().unwrap();
    let path = dir.path().join("cost.mcap");
    let mut recorder = Recorder::create(&path, &Header::default(), &Options::default()).unwrap();
    let at = |name: &str| StreamDesc::new(name).frame("local");
    let head = recorder.stream::<RawLocation>(&at("/head")).unwrap();
    let views = recorder.stream::<RawViews>(&at("/views")).unwrap();
    let joints = recorder.stream::<RawJoints>(&at("/hand/left/joints")).unwrap();
    let button = recorder.stream::<Button>(&at("/select")).unwrap();
    let axis = recorder.stream::<Axis>(&at("/trigger")).unwrap();
    let stick = recorder.stream::<Vector2>(&at("/stick")).unwrap();
    let haptic = recorder.stream::<Haptic>(&at("/haptic")).unwrap();
    let frame = recorder.stream::<FrameTiming>(&at("/frame")).unwrap();
    let event = recorder.stream::<Event>(&at("/event")).unwrap();
    let cpu = recorder.stream::<Scalar>(&at("/cpu").host_time()).unwrap();

    let view = RawView { pose: RawPose::IDENTITY, fov_rad: [-0.8, 0.8, 0.8, -0.8] };
    let two = RawViews::new(Validity::ALL, &[view; 2]).unwrap();
    let joint = RawJoint { pose: RawPose::IDENTITY, validity: Validity::ALL, radius_m: 0.01 };
    let hand = RawJoints { is_active: true, joints: [joint; JOINTS_PER_HAND] };
    let mut asked_before = 0;
    for step in 0..2000 {
        // The first second: buffers grow to the largest message.
        if step == 90 {
            asked_before = ASKED.get();
        }
        let now = Timestamp::from_nanos(step * 11_111_111);
        let times = Times::at(now);
        let said = RawLocation { pose: RawPose::IDENTITY, validity: Validity::ALL, velocity: None };
        recorder.write(&head, times, &said);
        recorder.write(&views, times, &two);
        recorder.write(&joints, times, &hand);
        recorder.write(&button, times, &Button(Some(true)));
        recorder.write(&axis, times, &Axis(Some(0.5)));
        recorder.write(&stick, times, &Vector2(None));
        recorder.write(&haptic, times, &Haptic::TICK);
        recorder.write(&event, times, &Event::new("state", "focused"));
        recorder.write(&cpu, times, &Scalar(1.0));
        recorder.write(
            &frame,
            times,
            &FrameTiming {
                frame: step as u64,
                wait_returned: now,
                begun: now,
                submitted: Some(now),
                predicted_display: now,
                predicted_period: Span::from_millis(11),
                should_render: true,
                presented: None,
                raw_display: now,
                raw_period: Span::from_millis(11),
                ended: true,
            },
        );
        // Not faster than the writer on a busy machine.
        if step % 100 == 0 {
            std::thread::sleep(std::time::Duration::from_millis(2));
        }
    }
    let asked = ASKED.get() - asked_before;
    assert_eq!(asked, 0, "allocations in {} frames", 2000 - 90);
    assert!(asked_before > 0, "nothing was counted");
    assert_eq!(recorder.finish().unwrap().dropped, 0);
}
