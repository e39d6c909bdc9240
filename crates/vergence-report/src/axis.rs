use crate::Error;

/// One axis of a plot.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    pub(crate) label: String,
    pub(crate) scale: Scale,
    pub(crate) range: Option<(f64, f64)>,
}

/// How values become lengths.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Equal differences are equally long.
    Linear,
    /// Equal ratios are equally long; values must be positive.
    Log,
}

impl Axis {
    /// A linear axis; `label` says what and in which unit. It starts at zero where no value is negative.
    pub fn linear(label: impl Into<String>) -> Self {
        Self { label: label.into(), scale: Scale::Linear, range: None }
    }

    /// A logarithmic axis; values that are not positive are left out and counted below the plot.
    pub fn log(label: impl Into<String>) -> Self {
        Self { label: label.into(), scale: Scale::Log, range: None }
    }

    /// From `low` to `high`, whatever the data.
    pub fn with_range(mut self, low: f64, high: f64) -> Self {
        self.range = Some((low, high));
        self
    }

    /// Whether a value has a place on such an axis.
    pub(crate) fn accepts(&self, value: f64) -> bool {
        value.is_finite() && (self.scale == Scale::Linear || value > 0.0)
    }

    /// The axis for `values` (those it accepts), along `length_px` pixels.
    pub(crate) fn laid_out(
        &self,
        values: impl Iterator<Item = f64>,
        length_px: f64,
    ) -> Result<Layout, Error> {
        let (low, high) = match self.range {
            Some((low, high)) => {
                let positive = if self.scale == Scale::Log { " and positive" } else { "" };
                if !(self.accepts(low) && self.accepts(high) && low < high) {
                    return Err(Error::Range { axis: self.label.clone(), positive, found: (low, high) });
                }
                (low, high)
            }
            None => self.fitted(values.filter(|&v| self.accepts(v))),
        };
        let ticks = match self.scale {
            Scale::Linear => linear_ticks(low, high),
            Scale::Log => log_ticks(low, high),
        };
        let forward = |v: f64| if self.scale == Scale::Log { v.ln() } else { v };
        let (from, to) = (forward(low), forward(high));
        let scale = length_px / (to - from);
        Ok(Layout { scale: self.scale, from, scale_px: scale, low, high, ticks })
    }

    /// A range with a little air around the values.
    fn fitted(&self, values: impl Iterator<Item = f64>) -> (f64, f64) {
        let (low, high) =
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        match self.scale {
            _ if low > high => (if self.scale == Scale::Log { 0.1 } else { 0.0 }, 1.0),
            Scale::Log => {
                let air = (high / low).powf(0.06).clamp(1.15, 1e3);
                // Kept off the ends of what a double holds.
                ((low / air).clamp(1e-300, 1e299), (high * air).clamp(1e-299, 1e300))
            }
            Scale::Linear => {
                let low = if low >= 0.0 { 0.0 } else { low };
                let high = if high <= 0.0 && low < 0.0 { 0.0 } else { high };
                let (low, high) = (low.max(-1e300), high.min(1e300));
                let air = 0.06 * (high - low);
                // All zero, or so close together that the air would be lost in rounding.
                let air =
                    if air > 1e-12 * high.abs().max(low.abs()) { air } else { (0.1 * high.abs()).max(0.5) };
                (
                    if low == 0.0 { 0.0 } else { low - air },
                    if high == 0.0 && low < 0.0 { 0.0 } else { high + air },
                )
            }
        }
    }
}

/// Where values go along an axis, in pixels from its start.
pub(crate) struct Layout {
    scale: Scale,
    from: f64,
    scale_px: f64,
    low: f64,
    high: f64,
    pub ticks: Vec<(f64, String)>,
}

impl Layout {
    pub fn position(&self, value: f64) -> f64 {
        (if self.scale == Scale::Log { value.ln() } else { value } - self.from) * self.scale_px
    }

    pub fn contains(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }
}

/// About six ticks at 1, 2 or 5 times a power of ten.
fn linear_ticks(low: f64, high: f64) -> Vec<(f64, String)> {
    let rough = (high - low) / 6.0;
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|s| *s >= rough).unwrap_or(power);
    let decimals = (-step.log10() - 1e-9).ceil().clamp(0.0, 12.0) as usize;
    let (first, last) = ((low / step - 1e-9).ceil(), (high / step + 1e-9).floor());
    let count = (last - first).clamp(0.0, 20.0) as usize;
    let largest = low.abs().max(high.abs());
    (0..=count)
        .map(|i| (first + i as f64) * step)
        .map(|v| if v.abs() < 1e-9 * step { 0.0 } else { v })
        .map(|v| {
            let plain = (1e-4..1e7).contains(&largest);
            (v, if plain || v == 0.0 { format!("{v:.decimals$}") } else { format!("{v:.1e}") })
        })
        .collect()
}

/// The decades; with 2 and 5 (3 and 7) where there are few, and linear ticks well within one decade.
fn log_ticks(low: f64, high: f64) -> Vec<(f64, String)> {
    let decades = (high / low).log10();
    if decades < 0.7 {
        return linear_ticks(low, high).into_iter().filter(|(v, _)| *v > 0.0).collect();
    }
    let mantissas: &[f64] = match decades {
        d if d < 1.5 => &[1.0, 2.0, 3.0, 5.0, 7.0],
        d if d < 3.5 => &[1.0, 2.0, 5.0],
        _ => &[1.0],
    };
    let every = (decades / 8.0).ceil().max(1.0) as i32;
    let (first, last) = (low.log10().floor() as i32, high.log10().ceil() as i32);
    let mut ticks = Vec::new();
    for exponent in (first..=last).filter(|e| e.rem_euclid(every) == 0) {
        for mantissa in mantissas {
            let value = mantissa * 10f64.powi(exponent);
            if (low * (1.0 - 1e-9)..=high * (1.0 + 1e-9)).contains(&value) {
                let plain = (-4..6).contains(&exponent);
                let decimals = (-exponent).max(0) as usize;
                ticks.push((
                    value,
                    if plain { format!("{value:.decimals$}") } else { format!("{value:.0e}") },
                ));
            }
        }
    }
    ticks
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(ticks: Vec<(f64, String)>) -> String {
        ticks.into_iter().map(|(_, label)| label).collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn ticks_are_round_numbers() {
        assert_eq!(labels(linear_ticks(0.0, 43.0)), "0 10 20 30 40");
        assert_eq!(labels(linear_ticks(-0.013, 0.021)), "-0.01 0.00 0.01 0.02");
        assert_eq!(labels(linear_ticks(3e8, 9e8)), "3.0e8 4.0e8 5.0e8 6.0e8 7.0e8 8.0e8 9.0e8");
        assert_eq!(labels(log_ticks(0.008, 3.0)), "0.01 0.02 0.05 0.1 0.2 0.5 1 2");
        assert_eq!(labels(log_ticks(1e-9, 1e9)), "1e-9 1e-6 0.001 1 1000 1e6 1e9");
        assert_eq!(labels(log_ticks(20.0, 45.0)), "20 25 30 35 40 45");
    }

    #[test]
    fn any_data_gives_a_usable_range() {
        let cases: [&[f64]; 9] = [
            &[],
            &[0.0],
            &[5.0],
            &[-3.0],
            &[f64::NAN, f64::INFINITY],
            &[1e-300, 1e300],
            &[f64::MAX, -f64::MAX],
            &[-1.0, 1.0],
            &[1e9, 1e9 + 1e-7],
        ];
        for axis in [Axis::linear("a"), Axis::log("b")] {
            for case in cases {
                let layout = axis.laid_out(case.iter().copied(), 500.0).unwrap();
                assert!(layout.low < layout.high && layout.scale_px.is_finite(), "{case:?}");
                for (value, _) in &layout.ticks {
                    assert!((-1.0..=501.0).contains(&layout.position(*value)), "{case:?} {value}");
                }
            }
        }
        assert!(Axis::log("x").with_range(0.0, 1.0).laid_out(std::iter::empty(), 9.0).is_err());
        assert!(Axis::linear("x").with_range(1.0, 1.0).laid_out(std::iter::empty(), 9.0).is_err());
    }
}
