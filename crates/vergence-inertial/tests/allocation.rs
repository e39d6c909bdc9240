//! No filter asks for memory after its start.
#![allow(unsafe_code, reason = "an allocator that counts")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use nalgebra::Vector3;
use vergence_inertial::filter::{Axes, Kind};
use vergence_sense::Imu;
use vergence_time::{Span, Timestamp};

struct Counting;

thread_local! {
    /// Of this thread: the one that runs the tests takes memory when it likes.
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

fn allocations() -> usize {
    ALLOCATIONS.with(Cell::get)
}

// SAFETY: every call goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let _ = ALLOCATIONS.try_with(|count| count.set(count.get() + 1));
        // SAFETY: the caller's promise is passed on.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise is passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

#[test]
fn a_sample_takes_no_memory() {
    for kind in Kind::ALL {
        let mut filter = kind.filter(Axes::Nine, Span::from_millis(5));
        let before = allocations();
        for i in 0..20_000 {
            let t = f64::from(i) * 0.005;
            let bad = i % 97 == 0;
            let imu = Imu {
                gyr_rad_s: Vector3::new(t.sin(), if bad { f64::NAN } else { 0.2 }, (0.3 * t).cos()),
                acc_m_s2: Vector3::new(t.cos(), 0.5, 9.8),
                mag_ut: Some(Vector3::new(16.0, t.sin(), -42.0)),
            };
            filter.update(Timestamp::from_nanos(i64::from(i) * 5_000_000), &imu);
            std::hint::black_box(filter.earth_from_sensor());
        }
        let found = allocations() - before;
        assert_eq!(found, 0, "{}", kind.name());
    }
    // And the counter counts.
    let before = allocations();
    drop(std::hint::black_box(vec![1u8; 100]));
    assert!(allocations() > before);
}
