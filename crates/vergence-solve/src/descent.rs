//! Levenberg and Marquardt's method.

use crate::normal::Normal;

/// A sum of squares over states that only it knows.
pub trait Problem {
    /// Unknowns of a step (what the problem eliminates itself not counted).
    fn dimension(&self) -> usize;

    /// Adds everything, linearised at the present state, to `normal` (which is zero and has the right dimension);
    /// returns the cost there. `damping` is for what the problem eliminates itself.
    fn linearise(&mut self, damping: f64, normal: &mut Normal) -> f64;

    /// Moves the state by `by`, and what was eliminated along with it; returns the cost there.
    fn step(&mut self, by: &[f64]) -> f64;

    /// Back to where the state was before the last [`Self::step`].
    fn undo(&mut self);
}

/// When to stop and how to begin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Accepted and refused steps together; 20. Cost grows with it.
    pub iterations: usize,
    /// Damping at the start, as a share of the diagonal; 1e-4.
    pub damping: f64,
    /// Stops where a step lowers the cost by less than this share of it; 1e-9.
    pub cost_share: f64,
    /// Stops where no unknown moves by more than this; 1e-9.
    pub smallest_step: f64,
    /// Least diagonal that the damping is a share of: holds unknowns that nothing determines; 1e-9.
    pub floor: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self { iterations: 20, damping: 1e-4, cost_share: 1e-9, smallest_step: 1e-9, floor: 1e-9 }
    }
}

/// How a minimisation went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Report {
    /// Cost at the start.
    pub first_cost: f64,
    /// Cost of the state that it ended with.
    pub cost: f64,
    /// Steps that were accepted.
    pub accepted: usize,
    /// Steps that were refused.
    pub refused: usize,
    /// It stopped because little was left to gain.
    pub converged: bool,
    /// Damping at the end.
    pub damping: f64,
}

/// Damping beyond which no step is tried.
const MOST_DAMPING: f64 = 1e8;

/// Minimises; the state ends at the best that was found. `normal` is working memory, and holds the equations at the last
/// linearisation afterwards.
pub fn minimise(problem: &mut dyn Problem, normal: &mut Normal, options: &Options) -> Report {
    let mut damping = options.damping;
    normal.reset(problem.dimension());
    let mut cost = problem.linearise(damping, normal);
    let mut report = Report { first_cost: cost, cost, damping, ..Report::default() };
    if !cost.is_finite() {
        return report;
    }
    let mut fresh = true;
    for _ in 0..options.iterations {
        if !fresh {
            normal.reset(problem.dimension());
            problem.linearise(damping, normal);
        }
        fresh = false;
        let next = normal.solve(damping, options.floor).map(|by| {
            let largest = by.iter().fold(0.0f64, |m, x| m.max(x.abs()));
            (problem.step(by), largest)
        });
        match next {
            Some((next, largest)) if next <= cost => {
                let gained = cost - next;
                cost = next;
                report.accepted += 1;
                damping = (damping / 3.0).max(1e-12);
                if gained <= options.cost_share * cost || largest <= options.smallest_step {
                    report.converged = true;
                    break;
                }
            }
            other => {
                report.refused += 1;
                if let Some((next, largest)) = other {
                    problem.undo();
                    // Worse only by rounding: this is the bottom.
                    if largest <= options.smallest_step || next - cost <= 1e-12 * cost {
                        report.converged = true;
                        break;
                    }
                }
                damping *= 8.0;
                if damping > MOST_DAMPING {
                    break;
                }
            }
        }
    }
    report.cost = cost;
    report.damping = damping;
    report
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix2, Vector2};

    use super::*;

    /// Rosenbrock's valley, as squares: (1 − x), 10 (y − x²); NaN beyond x = 3.
    struct Valley {
        at: Vector2<f64>,
        before: Vector2<f64>,
    }

    impl Valley {
        fn new(x: f64, y: f64) -> Self {
            Self { at: Vector2::new(x, y), before: Vector2::zeros() }
        }

        fn residual(&self) -> Vector2<f64> {
            let edge = if self.at.x > 3.0 { f64::NAN } else { 0.0 };
            Vector2::new(1.0 - self.at.x + edge, 10.0 * (self.at.y - self.at.x.powi(2)))
        }
    }

    impl Problem for Valley {
        fn dimension(&self) -> usize {
            2
        }

        fn linearise(&mut self, _: f64, normal: &mut Normal) -> f64 {
            let jacobian = Matrix2::new(-1.0, 0.0, -20.0 * self.at.x, 10.0);
            normal.add_square(0, &jacobian, &self.residual(), 1.0);
            0.5 * self.residual().norm_squared()
        }

        fn step(&mut self, by: &[f64]) -> f64 {
            self.before = self.at;
            self.at += Vector2::from_column_slice(by);
            0.5 * self.residual().norm_squared()
        }

        fn undo(&mut self) {
            self.at = self.before;
        }
    }

    #[test]
    fn the_bottom_of_the_valley_is_found_and_no_step_makes_it_worse() {
        for (x, y) in [(-1.2, 1.0), (2.9, -40.0), (0.0, 0.0), (-10.0, 3.0)] {
            let mut valley = Valley::new(x, y);
            let report = minimise(
                &mut valley,
                &mut Normal::default(),
                &Options { iterations: 200, ..Options::default() },
            );
            assert!(
                (valley.at - Vector2::new(1.0, 1.0)).norm() < 1e-6,
                "{x} {y}: {:?} {report:?}",
                valley.at
            );
            assert!(report.cost <= report.first_cost && report.converged, "{report:?}");
        }
    }

    #[test]
    fn where_nothing_can_be_done_the_state_is_left_alone() {
        let mut valley = Valley::new(5.0, 1.0);
        let report = minimise(&mut valley, &mut Normal::default(), &Options::default());
        assert!(!report.converged && report.accepted == 0 && valley.at == Vector2::new(5.0, 1.0));
    }
}
