//! Laws of the simulated person that hold whatever is measured: pure, smooth, within its geometry, never NaN.

use nalgebra::Vector3;
use proptest::prelude::*;
use vergence_sim::Error;
use vergence_sim::person::{Geometry, Params, Person, Selection, Target};
use vergence_time::{Span, Timestamp};

fn at_ms(ms: i64) -> Timestamp {
    Timestamp::from_nanos(ms * 1_000_000)
}

fn target(x: f64, y: f64, z: f64, width: f64) -> Target {
    Target { centre_m: Vector3::new(x, y, z), width: Some(width) }
}

const GEOMETRIES: [fn() -> Geometry; 4] = [
    || Geometry::Line { axis: Vector3::x_axis() },
    || Geometry::Plane { normal: Vector3::z_axis() },
    || Geometry::Volume,
    || Geometry::Directions,
];

#[test]
fn the_past_does_not_hang_on_what_is_seen_later_nor_on_who_asks() {
    for geometry in GEOMETRIES {
        let mut person = Person::new(3, geometry(), &Params::default()).unwrap();
        person.see(at_ms(0), target(0.2, 0.1, -1.0, 0.03)).unwrap();
        let ask = |person: &Person| (0..40).map(|k| person.at(at_ms(10 * k))).collect::<Vec<_>>();
        let before = ask(&person);
        let mut backwards: Vec<_> = (0..40).rev().map(|k| person.at(at_ms(10 * k))).collect();
        backwards.reverse();
        assert_eq!(before, backwards);
        // Forestalls the press.
        person.see(at_ms(400), target(-0.2, 0.0, -1.0, 0.02)).unwrap();
        assert_eq!(before, ask(&person));
        let mut other = Person::new(4, geometry(), &Params::default()).unwrap();
        other.see(at_ms(0), target(0.2, 0.1, -1.0, 0.03)).unwrap();
        assert_ne!(before, ask(&other));
    }
}

/// Also where a stimulus comes in the middle of a movement.
#[test]
fn the_hand_does_not_jump() {
    for geometry in GEOMETRIES {
        let mut person =
            Person::new(9, geometry(), &Params { start_m: -Vector3::z(), ..Params::default() }).unwrap();
        for k in 0..12 {
            let side = if k % 2 == 0 { 0.3 } else { -0.3 };
            person.see(at_ms(230 * k), target(side, 0.05, -1.0, 0.02)).unwrap();
        }
        // Half a metre in the shortest time that a movement may take, at its peak of 15/8 of the mean.
        const FASTEST_M_S: f64 = 15.0;
        for k in 0..4000i64 {
            let step = (person.at(at_ms(k + 1)).position_m - person.at(at_ms(k)).position_m).norm();
            assert!(step < FASTEST_M_S * 1e-3, "{k} ms: {step} m");
        }
    }
}

#[test]
fn the_cursor_stays_where_it_may_be() {
    let mut line = Person::new(1, GEOMETRIES[0](), &Params::default()).unwrap();
    let mut plane = Person::new(1, GEOMETRIES[1](), &Params::default()).unwrap();
    let mut sphere =
        Person::new(1, GEOMETRIES[3](), &Params { start_m: -2.0 * Vector3::z(), ..Params::default() })
            .unwrap();
    for k in 0..10 {
        let side = if k % 2 == 0 { 0.3 } else { -0.3 };
        line.see(at_ms(900 * k), target(side, 1.0, 1.0, 0.02)).unwrap();
        plane.see(at_ms(900 * k), target(side, 0.2, 1.0, 0.02)).unwrap();
        let way = Vector3::new(side, 0.1, -1.0).normalize() * 2.0;
        sphere.see(at_ms(900 * k), Target { centre_m: way, width: Some(0.02) }).unwrap();
    }
    for k in 0..9000 {
        let [l, p, s] = [&line, &plane, &sphere].map(|person| person.at(at_ms(k)).position_m);
        assert_eq!((l.y, l.z, p.z), (0.0, 0.0, 0.0));
        assert!((s.norm() - 2.0).abs() < 1e-12);
    }
}

#[test]
fn a_dwelling_person_ends_inside_and_presses_nothing() {
    let params = Params { selection: Selection::Dwell, margin: 0.7, tremor_m: 0.0, ..Params::default() };
    for seed in 0..200 {
        let mut person = Person::new(seed, Geometry::Volume, &params).unwrap();
        let goal = target(0.3, 0.1, -0.2, 0.03);
        person.see(at_ms(0), goal).unwrap();
        let settled = person.submovements().last().unwrap().ends();
        let hand = person.at(settled.saturating_add(Span::from_millis(500)));
        assert!((hand.position_m - goal.centre_m).norm() <= 0.015 && !hand.is_pressed);
        assert!(person.presses().is_empty());
    }
}

/// Without noise the person is exact, and takes the one submovement that the plan asks for.
#[test]
fn noise_can_be_switched_off() {
    let params = Params { noise_s: 0.001, tremor_m: 0.0, unevenness: 0.0, across: 0.0, ..Params::default() };
    let mut person = Person::new(0, Geometry::Volume, &params).unwrap();
    person.see(at_ms(0), target(0.3, 0.0, 0.0, 0.05)).unwrap();
    assert_eq!((person.submovements().len(), person.presses()), (1, &[at_ms(130)][..]));
}

#[test]
fn what_makes_no_sense_is_refused() {
    for params in [
        Params { noise_s: 0.0, ..Params::default() },
        Params { margin: f64::NAN, ..Params::default() },
        Params { onset_s: -0.1, ..Params::default() },
        Params { start_m: Vector3::new(f64::INFINITY, 0.0, 0.0), ..Params::default() },
    ] {
        assert!(
            matches!(Person::new(0, Geometry::Volume, &params), Err(Error::Parameter { .. })),
            "{params:?}"
        );
    }
    let mut person = Person::new(0, Geometry::Directions, &Params::default()).unwrap();
    assert!(person.see(at_ms(0), target(0.0, 0.0, 0.0, 0.1)).is_err());
    assert!(person.see(at_ms(0), target(0.0, f64::NAN, -1.0, 0.1)).is_err());
    assert!(person.see(at_ms(0), target(0.0, 0.0, -1.0, -0.1)).is_err());
    person.see(at_ms(5), target(0.0, 0.0, 1.0, 0.1)).unwrap();
    let error = person.see(at_ms(4), target(0.0, 0.0, -1.0, 0.1)).unwrap_err();
    assert_eq!(error.to_string(), "expected a stimulus at 5000000 ns or later, found one at 4000000 ns");
}

proptest! {
    /// Any target that is taken, as small, far or odd as it may be, is gone to in finite time without NaN.
    #[test]
    fn always_finite(
        seed: u64,
        which in 0usize..4,
        places in prop::collection::vec((prop::array::uniform3(-1e6f64..1e6), prop::option::of(0.0f64..1e6), 0i64..1_000_000_000), 1..8),
        scale in 1e-12f64..1.0,
        margin in 0.2f64..10.0,
        noise_s in 0.001f64..1.0,
        dwells: bool,
    ) {
        let selection = if dwells { Selection::Dwell } else { Params::default().selection };
        let params = Params { margin, noise_s, selection, ..Params::default() };
        let mut person = Person::new(seed, GEOMETRIES[which](), &params).unwrap();
        let mut now = 0;
        for (place, width, wait) in places {
            now += wait;
            let seen = Target { centre_m: Vector3::from(place) * scale, width: width.map(|w| w * scale * scale) };
            if person.see(Timestamp::from_nanos(now), seen).is_err() {
                continue;
            }
            let end = person.submovements().last().unwrap().ends();
            // Sixteen of each at most, each not longer than the easiest of all plans.
            prop_assert!(end.as_nanos() - now < 200_000_000_000_000);
            for time in [now, (now + end.as_nanos()) / 2, end.as_nanos()] {
                prop_assert!(person.at(Timestamp::from_nanos(time)).position_m.iter().all(|x| x.is_finite()));
            }
        }
    }
}
