/// How an axis answers between rest and full: odd, 0 at 0, ±1 at ±1, never falling.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Curve {
    /// As it is.
    #[default]
    Linear,
    /// To this power, 0.1 to 10. Above 1: fine near the middle, fast near the rim; below 1 the other way round.
    Power(f64),
    /// Straight between these points, from (0, 0) to (1, 1), which are not told.
    Points(Vec<[f64; 2]>),
}

impl Curve {
    /// As files have it: `linear`, `power 2`, `points 0.5:0.2 0.8:0.5`.
    ///
    /// # Errors
    /// What was expected.
    pub fn parse(text: &str) -> Result<Self, &'static str> {
        const EXPECTED: &str = "expected \"linear\", \"power 2\" (0.1 to 10) or \"points 0.5:0.2 0.8:0.5\" (ascending, 0 to 1, \
                                at most 32)";
        let mut words = text.split_whitespace();
        let curve = match words.next() {
            Some("linear") => Self::Linear,
            Some("power") => {
                let power: f64 = words.next().and_then(|word| word.parse().ok()).ok_or(EXPECTED)?;
                if !(0.1..=10.0).contains(&power) {
                    return Err(EXPECTED);
                }
                Self::Power(power)
            }
            Some("points") => {
                let mut points: Vec<[f64; 2]> = Vec::new();
                for word in words.by_ref().take(33) {
                    let (x, y) = word.split_once(':').ok_or(EXPECTED)?;
                    let (x, y): (f64, f64) = x.parse().ok().zip(y.parse().ok()).ok_or(EXPECTED)?;
                    let [before_x, before_y] = points.last().copied().unwrap_or([0.0; 2]);
                    // Written so that NaN is refused.
                    if !(x > before_x && x < 1.0 && y >= before_y && y <= 1.0) || points.len() == 32 {
                        return Err(EXPECTED);
                    }
                    points.push([x, y]);
                }
                Self::Points(points)
            }
            _ => return Err(EXPECTED),
        };
        if words.next().is_some() { Err(EXPECTED) } else { Ok(curve) }
    }

    /// The answer to a deflection; what is beyond ±1 is held there, what is no number is 0.
    pub fn apply(&self, deflection: f64) -> f64 {
        if deflection.is_nan() {
            return 0.0;
        }
        let x = deflection.abs().min(1.0);
        let y = match self {
            Self::Linear => x,
            Self::Power(power) => x.powf(*power),
            Self::Points(points) => {
                let next = points.partition_point(|point| point[0] <= x);
                let [x1, y1] = points.get(next).copied().unwrap_or([1.0; 2]);
                let [x0, y0] = next.checked_sub(1).map_or([0.0; 2], |before| points[before]);
                if x >= 1.0 { 1.0 } else { y0 + (y1 - y0) * (x - x0) / (x1 - x0) }
            }
        };
        y.copysign(deflection)
    }
}

impl std::fmt::Display for Curve {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Linear => f.write_str("linear"),
            Self::Power(power) => write!(f, "power {power}"),
            Self::Points(points) => {
                f.write_str("points")?;
                points.iter().try_for_each(|[x, y]| write!(f, " {x}:{y}"))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_keep_their_ends_and_rise() {
        for text in ["linear", "power 2", "power 0.5", "points 0.5:0.2 0.8:0.5", "points"] {
            let curve = Curve::parse(text).unwrap();
            assert_eq!(Curve::parse(&curve.to_string()).unwrap(), curve);
            assert_eq!(
                [-2.0, -1.0, 0.0, 1.0, f64::INFINITY].map(|x| curve.apply(x)),
                [-1.0, -1.0, 0.0, 1.0, 1.0]
            );
            let rising = (-100..100).map(|k| curve.apply(f64::from(k) / 100.0)).collect::<Vec<_>>();
            assert!(rising.windows(2).all(|pair| pair[0] <= pair[1]), "{text}");
            assert_eq!(curve.apply(f64::NAN), 0.0);
        }
        assert!((Curve::parse("points 0.5:0.2").unwrap().apply(-0.75) + 0.6).abs() < 1e-12);
        for text in [
            "",
            "power",
            "power 0",
            "power nan",
            "points 0.5:0.2 0.4:0.3",
            "points 1:1",
            "linear 3",
            "points 0.5",
        ] {
            assert!(Curve::parse(text).is_err(), "{text}");
        }
    }
}
