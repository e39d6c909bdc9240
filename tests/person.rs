//! The simulated person, measured as people are: by the study's own analysis.

use nalgebra::Vector3;
use vergence_sim::person::{Geometry, Params, Person, Target};
use vergence_study::{Analysis, Conventions, DataSet, Plane, Trial, analyse, layout};
use vergence_time::{Span, Timestamp};

/// Amplitudes (m) and widths (m).
const AMPLITUDES_M: [f64; 3] = [0.1, 0.2, 0.4];
const WIDTHS_M: [f64; 4] = [0.01, 0.02, 0.04, 0.08];
const TRIALS: u32 = 20;
const SEEDS: u64 = 20;

/// A task in all its forms: the study's layout, what the person moves in, and the dimensions of the analysis.
#[derive(Clone, Copy)]
enum Task {
    Reciprocal,
    Ring,
    Volume,
    Ray,
}

impl Task {
    fn study(self) -> vergence_study::Geometry {
        match self {
            Self::Reciprocal => vergence_study::Geometry::Reciprocal,
            Self::Ring => vergence_study::Geometry::Ring { targets: 11, plane: Plane::Xy },
            Self::Volume => vergence_study::Geometry::Ring { targets: 11, plane: Plane::Zx },
            Self::Ray => vergence_study::Geometry::Ray { targets: 11, distance: 2.0 },
        }
    }

    fn person(self) -> Geometry {
        match self {
            Self::Reciprocal => Geometry::Line { axis: Vector3::x_axis() },
            Self::Ring => Geometry::Plane { normal: Vector3::z_axis() },
            Self::Volume => Geometry::Volume,
            Self::Ray => Geometry::Directions,
        }
    }

    fn dimensions(self) -> usize {
        match self {
            Self::Reciprocal => 1,
            Self::Ring => 2,
            Self::Volume | Self::Ray => 3,
        }
    }
}

/// All conditions and seeds of one task; what is outside of the target's ball (or cone) at the press is a miss.
fn experiment(task: Task, params: &Params) -> Analysis {
    let mut data =
        DataSet { length_unit: "m".to_owned(), dimensions: task.dimensions(), ..DataSet::default() };
    for seed in 0..SEEDS {
        for (condition, (amplitude, width)) in
            AMPLITUDES_M.iter().flat_map(|a| WIDTHS_M.map(|w| (*a, w))).enumerate()
        {
            let targets = layout(task.study(), amplitude, width);
            let start_m = Vector3::from(targets[0].centre);
            let params = Params { start_m, ..*params };
            let mut person =
                Person::new(1000 * seed + condition as u64, task.person(), &params).expect("good parameters");
            let (mut now, mut from) = (Timestamp::from_nanos(0), start_m);
            for index in 0..TRIALS {
                // The first target of the list is where the round begins and ends.
                let place = targets[1 + index as usize % (targets.len() - 1)];
                let centre_m = Vector3::from(place.centre);
                let start = person.at(now).position_m;
                person.see(now, Target { centre_m, width: place.width }).expect("a good target");
                let pressed = *person.presses().last().expect("a press follows");
                let end = person.at(pressed).position_m;
                // Along a chord of the sphere the width is that of the cone.
                let (width_m, scale) =
                    if matches!(task, Task::Ray) { (2.0 * width, 2.0) } else { (width, 1.0) };
                data.trials.push(Trial {
                    participant: format!("P{seed}"),
                    condition: format!("A{amplitude} W{width}"),
                    index,
                    amplitude: Some(scale * amplitude),
                    width: Some(width_m),
                    from: Some(from.into()),
                    to: place.centre,
                    start: Some(start.into()),
                    end: end.into(),
                    mt_s: pressed.since(now).map_or(0.0, Span::as_secs_f64),
                    error: Some((end - centre_m).norm() > 0.5 * width_m),
                    ..Trial::default()
                });
                (now, from) = (pressed, centre_m);
            }
        }
    }
    analyse(&data, &Conventions::default())
}

/// What one experiment amounts to.
struct Found {
    mt_s: f64,
    errors: f64,
    throughput: f64,
    r_rows: f64,
    r_conditions: f64,
    a_s: f64,
    b_s: f64,
}

fn correlation(x: &[f64], y: &[f64]) -> f64 {
    let line = vergence_stats::linear(x, y).expect("points that span a line");
    line.r2.expect("a spread").max(0.0).sqrt() * line.coefficients[1].signum()
}

fn found(analysis: &Analysis) -> Found {
    let ends = |row: &vergence_study::Row| (row.ends.x.ide.expect("a spread"), row.ends.mt_s.expect("times"));
    let rows: Vec<(f64, f64)> = analysis.rows.iter().map(ends).collect();
    assert_eq!(rows.len() as u64, 12 * SEEDS);
    let (x, y): (Vec<f64>, Vec<f64>) = rows.into_iter().unzip();
    let mut names: Vec<&str> = analysis.rows.iter().map(|row| row.key.condition.as_str()).collect();
    names.sort_unstable();
    names.dedup();
    let mean = |name: &str| {
        let own: Vec<(f64, f64)> =
            analysis.rows.iter().filter(|row| row.key.condition == name).map(ends).collect();
        let n = own.len() as f64;
        (own.iter().map(|p| p.0).sum::<f64>() / n, own.iter().map(|p| p.1).sum::<f64>() / n)
    };
    let (cx, cy): (Vec<f64>, Vec<f64>) = names.iter().map(|name| mean(name)).unzip();
    let line = vergence_stats::linear(&cx, &cy).expect("twelve points");
    Found {
        mt_s: analysis.mean(|row| row.ends.mt_s).expect("times"),
        errors: analysis.error_rate().expect("trials"),
        throughput: analysis.tp_mean_of_means().expect("throughputs"),
        r_rows: correlation(&x, &y),
        r_conditions: correlation(&cx, &cy),
        a_s: line.coefficients[0],
        b_s: line.coefficients[1],
    }
}

fn print(what: &str, f: &Found) {
    println!(
        "{what:<30} {:>6.3} {:>6.1} {:>6.2} {:>8.3} {:>8.3} {:>7.3} {:>6.3}",
        f.mt_s,
        100.0 * f.errors,
        f.throughput,
        f.r_rows,
        f.r_conditions,
        f.a_s,
        f.b_s
    );
}

const HEAD: &str = "                                 MT s  err %  bit/s   r rows  r means     a s  b s/b";

/// 12 conditions × 20 trials × 20 seeds.
#[test]
fn fitts_law_comes_out() {
    println!("{HEAD}");
    for (name, task) in
        [("1D", Task::Reciprocal), ("2D", Task::Ring), ("3D", Task::Volume), ("rays", Task::Ray)]
    {
        let f = found(&experiment(task, &Params::default()));
        print(name, &f);
        assert!(f.r_rows >= 0.95 && f.r_conditions >= 0.98, "{name}: {} {}", f.r_rows, f.r_conditions);
        assert!((3.0..6.0).contains(&f.throughput) && f.errors < 0.15, "{name}");
    }
}

/// As in people: who is told to be fast is faster and misses more, at about the same throughput.
#[test]
fn speed_is_traded_for_accuracy_at_one_throughput() {
    println!("{HEAD}");
    for task in [Task::Reciprocal, Task::Ring] {
        let margins = [1.0, Params::FAST, 1.6, Params::BALANCED, 2.5, Params::ACCURATE];
        let all: Vec<Found> = margins
            .iter()
            .map(|margin| {
                let f = found(&experiment(task, &Params { margin: *margin, ..Params::default() }));
                print(&format!("margin {margin}"), &f);
                f
            })
            .collect();
        for pair in all.windows(2) {
            assert!(pair[0].mt_s < pair[1].mt_s && pair[0].errors > pair[1].errors);
        }
        let (first, last) = (&all[0], &all[margins.len() - 1]);
        assert!(last.mt_s > 1.25 * first.mt_s && first.errors > 0.2 && last.errors < 0.02);
        let tps: Vec<f64> = all.iter().map(|f| f.throughput).collect();
        let (low, high) = tps.iter().fold((f64::MAX, f64::MIN), |(l, h), x| (l.min(*x), h.max(*x)));
        let varies = (high - low) / (tps.iter().sum::<f64>() / tps.len() as f64);
        println!("throughput varies by {:.1} %", 100.0 * varies);
        assert!(varies <= 0.10, "{varies}");
    }
}

/// From 3 to 6 bit/s by one knob, at about the same share of misses.
#[test]
fn skill_is_a_knob_of_its_own() {
    println!("{HEAD}");
    let skills = [0.022, 0.028, 0.036, 0.05, 0.075];
    let all: Vec<Found> = skills
        .iter()
        .map(|noise_s| {
            let f = found(&experiment(Task::Reciprocal, &Params { noise_s: *noise_s, ..Params::default() }));
            print(&format!("noise {noise_s} s"), &f);
            f
        })
        .collect();
    assert!(all.windows(2).all(|pair| pair[0].throughput > pair[1].throughput));
    assert!(all[0].throughput >= 6.0 && all[4].throughput <= 3.0);
    for f in &all {
        assert!(f.r_rows >= 0.95 && f.errors < 0.08, "{} {}", f.r_rows, f.errors);
    }
}
