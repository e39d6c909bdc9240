//! The ellipsoid of a magnetometer, in a field that is not the same everywhere.
//!
//! Within buildings the field differs from place to place by more than a magnetometer's noise, and a hand that turns a unit
//! moves it. What that leaves in the lengths is the same from sample to sample, so a second at one attitude tells no more
//! than a moment. Readings are therefore gathered by direction: the mean of a cell of directions errs by the unevenness
//! and by its share of the noise, whose variances are both read off the recording (a model of random effects).

use std::collections::HashMap;

use nalgebra::{Matrix3, Vector3};

use super::ellipsoid::{Ellipsoid, HOLDABLE, Prior, Reading};

/// Size of a cell of directions, rad. With smaller ones neighbours err alike: of two recordings of one unit in one room
/// the numbers then differ by more than three of their deviations (0.05 rad: 4.3; 0.1: 1.9; 0.3: 2.9; 0.4: 1.8).
const CELL_RAD: f64 = 0.4;

/// Parts of the recording that are left out one after the other, to see what the numbers are worth and whether they foretell
/// what they were not fitted to.
const PARTS: usize = 8;

/// Variances of the numbers are at least this many times as large as the cells say, where the unevenness rules: of simulated
/// rooms the jackknife says 2.6 in the mean, but 1.2 to 3.7 of single ones, which err no less.
const UNEVEN_WIDER: f64 = 2.6;

/// A calibration must leave less than this share of the variance of parts that it was not fitted to. Where it does not, its
/// numbers are about the field, not about the unit.
///
/// Of recordings in rooms, two that are better for it leave 0.07 and 0.54; one that is neither better nor worse 0.75, and one
/// beside a magnet, which is worse for it by half a degree of heading, 0.81.
const LEAST_GAIN: f64 = 0.65;

/// What a recording tells.
pub(super) enum Told {
    /// Not turned enough.
    Nothing,
    /// As much is left of parts that were not looked at as without a calibration, µT: the unevenness of the field.
    Uneven(f64),
    /// An ellipsoid.
    Fit(Box<Ellipsoid>),
}

/// Cell of each reading, and how many cells there are.
fn cells(points: &[Reading], fit: &Ellipsoid, inverse: &Matrix3<f64>) -> (Vec<usize>, usize) {
    let mut numbers = HashMap::new();
    let all = points
        .iter()
        .map(|point| {
            let direction = (inverse * (point.vector - fit.offset)).try_normalize(1e-9).unwrap_or_default();
            let key: [i8; 3] = std::array::from_fn(|axis| (direction[axis] / CELL_RAD).round() as i8);
            let next = numbers.len();
            *numbers.entry(key).or_insert(next)
        })
        .collect();
    (all, numbers.len())
}

/// Sums and counts of `values` by their cell.
fn sums(values: impl Iterator<Item = (usize, f64)>, cells: usize) -> Vec<(f64, f64)> {
    let mut sums = vec![(0.0, 0.0); cells];
    for (cell, value) in values {
        sums[cell].0 += value;
        sums[cell].1 += 1.0;
    }
    sums
}

/// Gives each reading its noise and what it is worth, and says how much of the variance of a cell's mean is unevenness;
/// `None` where too few directions were seen for an ellipsoid.
fn weigh(points: &mut [Reading], fit: &Ellipsoid) -> Option<f64> {
    let inverse = fit.matrix.try_inverse()?;
    let (cell, count) = cells(points, fit, &inverse);
    let freedom = count.checked_sub(HOLDABLE + 1).filter(|freedom| *freedom > 0)?;
    let left: Vec<f64> = points.iter().map(|point| fit.left(&inverse, point)).collect();
    // Noise: what changes from one sample to the next.
    let steps: f64 = left.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum();
    let noise = (steps / (2.0 * (left.len() - 1) as f64)).max((1e-6 * fit.length).powi(2));
    let sums = sums(cell.iter().copied().zip(left.iter().copied()), count);
    let excess: f64 = sums.iter().map(|(sum, n)| (sum / n).powi(2) - noise / n).sum();
    let uneven = (excess / freedom as f64).max(0.0);
    for (point, cell) in points.iter_mut().zip(cell) {
        let n = sums[cell].1;
        *point = Reading { noise: noise.sqrt(), weight: 1.0 / (uneven * n + noise), ..*point };
    }
    let share = sums.iter().map(|(_, n)| uneven / (uneven + noise / n)).sum::<f64>() / count as f64;
    Some(share)
}

/// Which of [`PARTS`] each reading belongs to: as much turning in each, rests count for nothing.
fn parts(points: &[Reading], fit: &Ellipsoid) -> Vec<usize> {
    const TURN: f64 = 0.1;
    let mut turned = 0usize;
    let mut last = None::<Vector3<f64>>;
    let marks: Vec<usize> = points
        .iter()
        .map(|point| {
            let direction = (point.vector - fit.offset).try_normalize(1e-9).unwrap_or_default();
            if last.is_none_or(|last| (last - direction).norm() > TURN) {
                last = Some(direction);
                turned += 1;
            }
            turned - 1
        })
        .collect();
    marks.into_iter().map(|mark| mark * PARTS / turned.max(1)).collect()
}

/// The fits without one of the parts each.
fn without_parts(
    points: &[Reading],
    part: &[usize],
    fit: &Ellipsoid,
    length: Option<f64>,
) -> Option<Vec<Ellipsoid>> {
    (0..PARTS)
        .map(|out| Ellipsoid::fit(&others(points, part, out), length, &Prior::MAGNETOMETER, Some(fit)))
        .collect()
}

/// The readings of all parts but `out`.
fn others(points: &[Reading], part: &[usize], out: usize) -> Vec<Reading> {
    points.iter().zip(part).filter(|(_, part)| **part != out).map(|(point, _)| *point).collect()
}

/// How much more the numbers change with the parts that they are read off than their variances say (a jackknife, the mean
/// over the numbers); at least 1. Where the unevenness goes with direction and time in ways that cells do not catch.
fn widening(fits: &[Ellipsoid], fit: &Ellipsoid) -> f64 {
    let numbers = |o: &Vector3<f64>, m: &Matrix3<f64>| -> [f64; HOLDABLE] {
        [o.x, o.y, o.z, m.m11, m.m22, m.m33, m.m12, m.m13, m.m23]
    };
    let all: Vec<[f64; HOLDABLE]> = fits.iter().map(|e| numbers(&e.offset, &e.matrix)).collect();
    let deviations = numbers(&fit.offset_sd, &fit.matrix_sd);
    let n = all.len() as f64;
    let ratio = |i: usize| {
        let mean = all.iter().map(|numbers| numbers[i]).sum::<f64>() / n;
        let squares: f64 = all.iter().map(|numbers| (numbers[i] - mean).powi(2)).sum();
        squares * (n - 1.0) / n / deviations[i].powi(2).max(f64::MIN_POSITIVE)
    };
    ((0..HOLDABLE).map(ratio).sum::<f64>() / HOLDABLE as f64).max(1.0)
}

/// Mean squares of what is left in parts that were not fitted, by the `fits` without them: with what was seen of the
/// numbers, and with the length alone.
fn foretold(
    points: &[Reading],
    part: &[usize],
    fits: &[Ellipsoid],
    told: &Ellipsoid,
    length: Option<f64>,
) -> Option<(f64, f64)> {
    let (cell, count) = cells(points, told, &told.matrix.try_inverse()?);
    let score = |back: &[bool; HOLDABLE]| -> Option<f64> {
        let (mut squares, mut seen) = (0.0, 0.0);
        for (out, fit) in fits.iter().enumerate() {
            let fit = fit.clone().put_back(back, &others(points, part, out), length)?;
            let inverse = fit.matrix.try_inverse()?;
            let left = (0..points.len()).filter(|i| part[*i] == out);
            let left = left.map(|i| (cell[i], fit.left(&inverse, &points[i])));
            for (sum, n) in sums(left, count).into_iter().filter(|(_, n)| *n > 0.0) {
                squares += (sum / n).powi(2);
                seen += 1.0;
            }
        }
        (seen > 0.0).then(|| squares / seen)
    };
    Some((score(&told.unseen())?, score(&[true; HOLDABLE])?))
}

/// Fits the finite readings `seen`; `length` is the strength of the field, µT, where it is known.
pub(super) fn fit(seen: &[Vector3<f64>], length: Option<f64>) -> Told {
    found(seen, length).unwrap_or(Told::Nothing)
}

/// What was read off, with what it takes to judge it.
pub(super) struct Read {
    /// All numbers, seen or not.
    pub fit: Ellipsoid,
    points: Vec<Reading>,
    part: Vec<usize>,
    fits: Vec<Ellipsoid>,
}

/// Reads the numbers off; `None` where too few directions were seen.
pub(super) fn read(seen: &[Vector3<f64>], length: Option<f64>) -> Option<Read> {
    let size = seen.iter().map(|m| m.norm()).sum::<f64>() / seen.len().max(1) as f64;
    let noise = 0.02 * size;
    let mut points: Vec<Reading> =
        seen.iter().map(|m| Reading { vector: *m, noise, weight: 1.0 / (noise * noise) }).collect();
    let mut fit = Ellipsoid::fit(&points, length, &Prior::MAGNETOMETER, None)?;
    let mut uneven = 0.0;
    for _ in 0..3 {
        uneven = weigh(&mut points, &fit)?;
        fit = Ellipsoid::fit(&points, length, &Prior::MAGNETOMETER, Some(&fit))?;
    }
    let part = parts(&points, &fit);
    let fits = without_parts(&points, &part, &fit, length)?;
    let wider = widening(&fits, &fit).max(1.0 + (UNEVEN_WIDER - 1.0) * uneven);
    points.iter_mut().for_each(|point| point.weight /= wider);
    let fit = Ellipsoid::fit(&points, length, &Prior::MAGNETOMETER, Some(&fit))?;
    Some(Read { fit, points, part, fits })
}

fn found(seen: &[Vector3<f64>], length: Option<f64>) -> Option<Told> {
    let Read { fit, points, part, fits } = read(seen, length)?;
    let unseen = fit.unseen();
    if !unseen.contains(&false) {
        return None;
    }
    let fit = fit.put_back(&unseen, &points, length)?;
    let (with, without) = foretold(&points, &part, &fits, &fit, length)?;
    Some(if with <= LEAST_GAIN * without { Told::Fit(Box::new(fit)) } else { Told::Uneven(without.sqrt()) })
}
