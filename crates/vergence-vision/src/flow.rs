use nalgebra::{Matrix2, Vector2};

use crate::simd::{F8, Task, vectorised};
use crate::{Error, Level, Pyramid};

/// How [`Flow`] follows a patch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowKnobs {
    /// Side of the patch, pixels, odd, 5 to 23. Default 15. Small: follows what is small and near an edge of depth, but is lost
    /// in noise; large: steady, blurs depths together. Cost grows with 8, 16 and 24 columns.
    pub window_px: usize,
    /// Levels of the pyramids that are used, 1 to 8. Default 4. Each doubles the motion that is found without a prediction; cost
    /// grows in proportion.
    pub levels: usize,
    /// Steps on each level at most, 1 to 100. Default 15. Few: large motions end short of their goal.
    pub iterations: usize,
    /// A step below this many pixels is the last one, 1e-4 to 0.1. Default 0.01. Small: more steps, less error.
    pub epsilon_px: f64,
}

impl Default for FlowKnobs {
    fn default() -> Self {
        Self { window_px: 15, levels: 4, iterations: 15, epsilon_px: 0.01 }
    }
}

/// Where a patch was found again.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// Its centre, pixels of the first level.
    pub pixel: Vector2<f64>,
    /// How alike the patches are, −1 to 1: their correlation coefficient, 1 where they differ by brightness and contrast only.
    pub likeness: f32,
}

/// Follows patches from one picture to the next (Lucas and Kanade), from coarse to fine.
///
/// The inverse compositional form (Baker and Matthews, "Lucas-Kanade 20 years on", IJCV 56(3), 2004): gradients are those of the
/// patch and are made once for each level. What brightness and contrast do to the patch is projected out of the gradients (its
/// part 3), so that neither is estimated and neither moves the result.
#[derive(Clone, Debug)]
pub struct Flow {
    knobs: FlowKnobs,
    template: Box<Template>,
}

/// Columns, in vectors of eight; also the most rows.
const WIDEST: usize = 24;
/// Squared gradient along the weaker direction, per pixel, below which a patch cannot be placed: (grey levels per pixel)².
const WEAKEST: f32 = 0.05;

#[derive(Clone, Debug)]
struct Template {
    /// The patch with a margin of one pixel.
    patch: [f32; (WIDEST + 8) * (WIDEST + 2)],
    /// Its values less their mean, and its gradients without what brightness and contrast explain; zero beyond the window.
    centred: [f32; WIDEST * WIDEST],
    by_x: [f32; WIDEST * WIDEST],
    by_y: [f32; WIDEST * WIDEST],
}

impl Flow {
    /// # Errors
    /// A knob outside of its range.
    pub fn new(knobs: FlowKnobs) -> Result<Self, Error> {
        let wrong = |name, expected, found: String| Err(Error::Knob { name, expected, found });
        if knobs.window_px.is_multiple_of(2) || !(5..=23).contains(&knobs.window_px) {
            return wrong("window_px", "an odd number from 5 to 23", knobs.window_px.to_string());
        }
        if !(1..=8).contains(&knobs.levels) {
            return wrong("levels", "1 to 8", knobs.levels.to_string());
        }
        if !(1..=100).contains(&knobs.iterations) {
            return wrong("iterations", "1 to 100", knobs.iterations.to_string());
        }
        if !(1e-4..=0.1).contains(&knobs.epsilon_px) {
            return wrong("epsilon_px", "1e-4 to 0.1", knobs.epsilon_px.to_string());
        }
        let template = Box::new(Template {
            patch: [0.0; (WIDEST + 8) * (WIDEST + 2)],
            centred: [0.0; WIDEST * WIDEST],
            by_x: [0.0; WIDEST * WIDEST],
            by_y: [0.0; WIDEST * WIDEST],
        });
        Ok(Self { knobs, template })
    }

    /// The settings.
    pub fn knobs(&self) -> &FlowKnobs {
        &self.knobs
    }

    /// Where the patch around `pixel` of `from` is in `to`, looked for around `guess` on the levels from `coarsest` to 0; pixels of
    /// the first level. `warp` takes offsets within the patch of `to` to offsets in `from` (identity where there is
    /// nothing better; a turn or a scale that is known beforehand).
    ///
    /// `None` where the patch cannot be placed, leaves the picture, or its place does not settle.
    pub fn follow(
        &mut self,
        from: &Pyramid,
        to: &Pyramid,
        pixel: &Vector2<f64>,
        guess: &Vector2<f64>,
        coarsest: usize,
        warp: Option<&Matrix2<f64>>,
    ) -> Option<Found> {
        self.approach(from, to, pixel, guess, (coarsest, 0), warp)
    }

    /// [`follow`](Self::follow) on the levels from `coarsest` to `finest` only, for whoever looks more closely afterwards. Where `finest` is
    /// above 0, the likeness is not measured (0), and the guess comes back where no level shows enough.
    pub(crate) fn approach(
        &mut self,
        from: &Pyramid,
        to: &Pyramid,
        pixel: &Vector2<f64>,
        guess: &Vector2<f64>,
        (coarsest, finest): (usize, usize),
        warp: Option<&Matrix2<f64>>,
    ) -> Option<Found> {
        let levels = self.knobs.levels.min(from.levels().len()).min(to.levels().len());
        let mut found = Found { pixel: *guess, likeness: -1.0 };
        let first = &from.levels()[0];
        let inside = |p: &Vector2<f64>, margin: f64| {
            p.x >= margin
                && p.y >= margin
                && p.x <= first.width() as f64 - 1.0 - margin
                && p.y <= first.height() as f64 - 1.0 - margin
        };
        // A turn of the patch of less than a third of a pixel at its edge is left to the iteration.
        let half = (self.knobs.window_px / 2) as f64;
        let warp = warp.filter(|warp| ((*warp - Matrix2::identity()) * half).norm() > 0.4);
        if !inside(pixel, 0.0) || warp.is_some_and(|warp| warp.norm().is_nan() || warp.norm() > 2.0) {
            return None;
        }
        for level in (finest..=coarsest.min(levels - 1)).rev() {
            let scale = 1.0 / f64::from(1u32 << level);
            let step = Step {
                from: &from.levels()[level],
                to: &to.levels()[level],
                pixel: pixel * scale,
                guess: found.pixel * scale,
                warp,
                knobs: &self.knobs,
                template: &mut self.template,
                finest: level == 0,
            };
            let outcome = match self.knobs.window_px {
                ..=8 => vectorised(Columns::<1>(step)),
                9..=16 => vectorised(Columns::<2>(step)),
                _ => vectorised(Columns::<3>(step)),
            };
            match outcome {
                Some(placed) => {
                    found = Found { pixel: placed.pixel / scale, likeness: placed.likeness };
                }
                // A coarse picture may show too little of it; the finest one must not.
                None if level > 0 => {}
                None => return None,
            }
        }
        inside(&found.pixel, 0.0).then_some(found)
    }
}

impl Flow {
    /// Which of `places` in `to` is most like the patch around `pixel` of `from`, and how alike (−1 to 1); all are pixels of the
    /// level `level`, not of the first. `None` where the patch is flat or no place is near the picture.
    pub fn likeliest(
        &mut self,
        from: &Pyramid,
        to: &Pyramid,
        level: usize,
        pixel: &Vector2<f64>,
        places: &[Vector2<f64>],
    ) -> Option<(usize, f32)> {
        let step = Step {
            from: from.levels().get(level)?,
            to: to.levels().get(level)?,
            pixel: *pixel,
            guess: *pixel,
            warp: None,
            knobs: &self.knobs,
            template: &mut self.template,
            finest: true,
        };
        match self.knobs.window_px {
            ..=8 => vectorised(Compare { columns: Columns::<1>(step), places }),
            9..=16 => vectorised(Compare { columns: Columns::<2>(step), places }),
            _ => vectorised(Compare { columns: Columns::<3>(step), places }),
        }
    }
}

/// One patch on one level.
struct Step<'a> {
    from: &'a Level,
    to: &'a Level,
    pixel: Vector2<f64>,
    guess: Vector2<f64>,
    warp: Option<&'a Matrix2<f64>>,
    knobs: &'a FlowKnobs,
    template: &'a mut Template,
    finest: bool,
}

/// The same with `N` vectors of eight columns.
struct Columns<'a, const N: usize>(Step<'a>);

/// Rows of a level from a place on, and how far the place is between pixels.
#[derive(Clone, Copy)]
struct Place<'a> {
    raw: &'a [u8],
    stride: usize,
    start: usize,
    right: f32,
    down: f32,
}

impl<'a> Place<'a> {
    /// From the pixel that is `back` left of and above `pixel` on; `None` where that is far outside.
    #[inline(always)]
    fn new(level: &'a Level, pixel: &Vector2<f64>, back: isize) -> Option<Self> {
        const REACH: f64 = 8.0;
        let near = pixel.x > -REACH
            && pixel.y > -REACH
            && pixel.x < level.width() as f64 + REACH
            && pixel.y < level.height() as f64 + REACH;
        if !near {
            return None;
        }
        let (x, y) = (pixel.x.floor(), pixel.y.floor());
        let (raw, stride) = level.raw();
        let start = level.origin() as isize + (y as isize - back) * stride as isize + (x as isize - back);
        let start = usize::try_from(start).ok()?;
        Some(Self { raw, stride, start, right: (pixel.x - x) as f32, down: (pixel.y - y) as f32 })
    }

    /// `M` vectors of row `y`, between the columns.
    #[inline(always)]
    fn across<const M: usize>(&self, y: usize) -> [F8; M] {
        let row = &self.raw[self.start + y * self.stride..][..8 * M + 1];
        let (left, right) = (F8::splat(1.0 - self.right), F8::splat(self.right));
        std::array::from_fn(|n| {
            F8::from_bytes(&row[8 * n..]) * left + F8::from_bytes(&row[8 * n + 1..]) * right
        })
    }
}

impl<const N: usize> Columns<'_, N> {
    /// Fills the template's patch, a margin of one pixel around the window. `WIDE` is one vector more than `N`.
    #[inline(always)]
    fn sample<const WIDE: usize>(&mut self) -> Option<()> {
        let Step { from, pixel, warp, knobs, template, .. } = &mut self.0;
        let rows = knobs.window_px + 2;
        let half = (knobs.window_px / 2) as isize;
        match warp {
            None => {
                let place = Place::new(from, pixel, half + 1)?;
                let (upper, lower) = (F8::splat(1.0 - place.down), F8::splat(place.down));
                let mut above = place.across::<WIDE>(0);
                for y in 0..rows {
                    let below = place.across::<WIDE>(y + 1);
                    let row = &mut template.patch[y * (8 * WIDE)..][..8 * WIDE];
                    for n in 0..WIDE {
                        (above[n] * upper + below[n] * lower).store(&mut row[8 * n..]);
                    }
                    above = below;
                }
            }
            Some(warp) => {
                for y in 0..rows {
                    for x in 0..rows {
                        let offset = Vector2::new(x as f64, y as f64).add_scalar(-(half as f64) - 1.0);
                        let place = Place::new(from, &(*pixel + **warp * offset), 0)?;
                        let above = &place.raw[place.start..][..2];
                        let below = &place.raw[place.start + place.stride..][..2];
                        let mix = |row: &[u8]| {
                            f32::from(row[0]) * (1.0 - place.right) + f32::from(row[1]) * place.right
                        };
                        template.patch[y * (8 * WIDE) + x] =
                            mix(above) * (1.0 - place.down) + mix(below) * place.down;
                    }
                }
            }
        }
        Some(())
    }

    /// Gradients without what brightness and contrast explain, and the inverse of their matrix; `None` where it is too flat.
    #[inline(always)]
    fn prepare<const WIDE: usize>(&mut self) -> Option<([f32; 3], f32)> {
        self.sample::<WIDE>()?;
        let window = self.0.knobs.window_px;
        let template = &mut *self.0.template;
        let mask: [F8; N] =
            std::array::from_fn(|n| F8(std::array::from_fn(|i| if 8 * n + i < window { 1.0 } else { 0.0 })));
        let zero = F8::splat(0.0);
        let half = F8::splat(0.5);
        let mut sums = [zero; 3];
        for y in 0..window {
            let row = |dy: usize| &template.patch[(y + dy) * (8 * WIDE)..][..8 * WIDE];
            for (n, &mask) in mask.iter().enumerate() {
                let value = F8::load(&row(1)[8 * n + 1..]) * mask;
                let by_x = (F8::load(&row(1)[8 * n + 2..]) - F8::load(&row(1)[8 * n..])) * half * mask;
                let by_y = (F8::load(&row(2)[8 * n + 1..]) - F8::load(&row(0)[8 * n + 1..])) * half * mask;
                let at = y * (8 * N) + 8 * n;
                value.store(&mut template.centred[at..]);
                by_x.store(&mut template.by_x[at..]);
                by_y.store(&mut template.by_y[at..]);
                sums = [sums[0] + value, sums[1] + by_x, sums[2] + by_y];
            }
        }
        let count = 1.0 / (window * window) as f32;
        let mean = sums.map(|sum| F8::splat(sum.sum() * count));
        let mut products = [zero; 3];
        for y in 0..window {
            for (n, &mask) in mask.iter().enumerate() {
                let at = y * (8 * N) + 8 * n;
                let value = F8::load(&template.centred[at..]) - mean[0] * mask;
                let by_x = F8::load(&template.by_x[at..]) - mean[1] * mask;
                let by_y = F8::load(&template.by_y[at..]) - mean[2] * mask;
                value.store(&mut template.centred[at..]);
                by_x.store(&mut template.by_x[at..]);
                by_y.store(&mut template.by_y[at..]);
                products =
                    [products[0] + value * value, products[1] + value * by_x, products[2] + value * by_y];
            }
        }
        let energy = products[0].sum();
        if energy <= 0.0 {
            return None;
        }
        let (along_x, along_y) =
            (F8::splat(products[1].sum() / energy), F8::splat(products[2].sum() / energy));
        let mut matrix = [zero; 3];
        for y in 0..window {
            for n in 0..N {
                let at = y * (8 * N) + 8 * n;
                let value = F8::load(&template.centred[at..]);
                let by_x = F8::load(&template.by_x[at..]) - value * along_x;
                let by_y = F8::load(&template.by_y[at..]) - value * along_y;
                by_x.store(&mut template.by_x[at..]);
                by_y.store(&mut template.by_y[at..]);
                matrix = [matrix[0] + by_x * by_x, matrix[1] + by_x * by_y, matrix[2] + by_y * by_y];
            }
        }
        let [xx, xy, yy] = matrix.map(F8::sum);
        let weaker = 0.5 * (xx + yy - ((xx - yy) * (xx - yy) + 4.0 * xy * xy).sqrt());
        if weaker * count < WEAKEST {
            return None;
        }
        let scale = 1.0 / (xx * yy - xy * xy);
        Some(([yy * scale, -xy * scale, xx * scale], energy))
    }

    #[inline(always)]
    fn place<const WIDE: usize>(mut self) -> Option<Found> {
        let (inverse, energy) = self.prepare::<WIDE>()?;
        let Step { to, guess, knobs, template, finest, .. } = self.0;
        let window = knobs.window_px;
        let half = (window / 2) as isize;
        let mut pixel = guess;
        let zero = F8::splat(0.0);
        for _ in 0..knobs.iterations {
            let place = Place::new(to, &pixel, half)?;
            let (upper, lower) = (F8::splat(1.0 - place.down), F8::splat(place.down));
            let mut above = place.across::<N>(0);
            let (mut along_x, mut along_y) = ([zero; N], [zero; N]);
            for y in 0..window {
                let below = place.across::<N>(y + 1);
                let by_x = &template.by_x[y * (8 * N)..][..8 * N];
                let by_y = &template.by_y[y * (8 * N)..][..8 * N];
                for n in 0..N {
                    let value = above[n] * upper + below[n] * lower;
                    along_x[n] = along_x[n] + value * F8::load(&by_x[8 * n..]);
                    along_y[n] = along_y[n] + value * F8::load(&by_y[8 * n..]);
                }
                above = below;
            }
            let total = |all: [F8; N]| all.into_iter().fold(zero, |sum, x| sum + x).sum();
            let (x, y) = (total(along_x), total(along_y));
            let step = Vector2::new(
                f64::from(inverse[0] * x + inverse[1] * y),
                f64::from(inverse[1] * x + inverse[2] * y),
            );
            let length = step.norm();
            // A step over half the patch says that there is nothing alike.
            if length.is_nan() || length > half as f64 + 1.0 {
                return None;
            }
            pixel -= step;
            if length < knobs.epsilon_px {
                break;
            }
        }
        if (pixel - guess).norm() > (2 * window) as f64 {
            return None;
        }
        if !finest {
            return Some(Found { pixel, likeness: 0.0 });
        }
        let likeness = likeness::<N>(to, &pixel, template, window, energy)?;
        Some(Found { pixel, likeness })
    }
}

/// How alike the patch around `pixel` is to the template.
#[inline(always)]
fn likeness<const N: usize>(
    to: &Level,
    pixel: &Vector2<f64>,
    template: &Template,
    window: usize,
    energy: f32,
) -> Option<f32> {
    let zero = F8::splat(0.0);
    let place = Place::new(to, pixel, (window / 2) as isize)?;
    let (upper, lower) = (F8::splat(1.0 - place.down), F8::splat(place.down));
    let mut above = place.across::<N>(0);
    let (mut sum, mut square, mut product) = (zero, zero, zero);
    let middle = F8::splat(128.0);
    let mask: [F8; N] =
        std::array::from_fn(|n| F8(std::array::from_fn(|i| if 8 * n + i < window { 1.0 } else { 0.0 })));
    for y in 0..window {
        let below = place.across::<N>(y + 1);
        for n in 0..N {
            let value = (above[n] * upper + below[n] * lower - middle) * mask[n];
            sum = sum + value;
            square = square + value * value;
            product = product + value * F8::load(&template.centred[y * (8 * N) + 8 * n..]);
        }
        above = below;
    }
    let sum = sum.sum();
    let variance = square.sum() - sum * sum / (window * window) as f32;
    Some(if variance > 0.0 { product.sum() / (variance * energy).sqrt() } else { -1.0 })
}

/// Which of several places is most alike.
struct Compare<'a, const N: usize> {
    columns: Columns<'a, N>,
    places: &'a [Vector2<f64>],
}

impl<const N: usize> Compare<'_, N> {
    #[inline(always)]
    fn best<const WIDE: usize>(mut self) -> Option<(usize, f32)> {
        let (_, energy) = self.columns.prepare::<WIDE>()?;
        let Step { to, knobs, template, .. } = self.columns.0;
        let mut best = None;
        for (index, place) in self.places.iter().enumerate() {
            if let Some(likeness) = likeness::<N>(to, place, template, knobs.window_px, energy)
                && best.is_none_or(|(_, most)| likeness > most)
            {
                best = Some((index, likeness));
            }
        }
        best
    }
}

impl Task for Compare<'_, 1> {
    type Out = Option<(usize, f32)>;

    #[inline(always)]
    fn run(self) -> Self::Out {
        self.best::<2>()
    }
}

impl Task for Compare<'_, 2> {
    type Out = Option<(usize, f32)>;

    #[inline(always)]
    fn run(self) -> Self::Out {
        self.best::<3>()
    }
}

impl Task for Compare<'_, 3> {
    type Out = Option<(usize, f32)>;

    #[inline(always)]
    fn run(self) -> Self::Out {
        self.best::<4>()
    }
}

impl Task for Columns<'_, 1> {
    type Out = Option<Found>;

    #[inline(always)]
    fn run(self) -> Option<Found> {
        self.place::<2>()
    }
}

impl Task for Columns<'_, 2> {
    type Out = Option<Found>;

    #[inline(always)]
    fn run(self) -> Option<Found> {
        self.place::<3>()
    }
}

impl Task for Columns<'_, 3> {
    type Out = Option<Found>;

    #[inline(always)]
    fn run(self) -> Option<Found> {
        self.place::<4>()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::Gray;

    const WIDTH: usize = 200;
    const HEIGHT: usize = 160;

    /// A smooth texture seen through an affine map, as bytes.
    fn picture(map: impl Fn(f64, f64) -> (f64, f64), gain: f64, offset: f64) -> Pyramid {
        let shade = |x: f64, y: f64| {
            let mut sum = 0.0;
            for k in 1..=12 {
                let k = f64::from(k);
                let (angle, length) = (k * 2.399, 7.0 + 1.9 * k);
                sum += ((x * angle.cos() + y * angle.sin()) * std::f64::consts::TAU / length + k * k).sin();
            }
            sum
        };
        let pixel = |i: usize| {
            let (x, y) = map((i % WIDTH) as f64, (i / WIDTH) as f64);
            (offset + gain * 11.0 * shade(x, y)).clamp(0.0, 255.0).round() as u8
        };
        let pixels: Vec<u8> = (0..WIDTH * HEIGHT).map(pixel).collect();
        let mut pyramid = Pyramid::new(WIDTH, HEIGHT, 4);
        pyramid.build(&Gray::new(WIDTH, HEIGHT, WIDTH, &pixels).unwrap());
        pyramid
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        /// 0.06 px: the picture is rounded to grey levels and read between pixels.
        #[test]
        fn a_patch_is_found_again_in_other_light(
            dx in -5.0..5.0f64, dy in -5.0..5.0f64, gain in 0.6..1.3f64, offset in 110.0..140.0f64, window in 3usize..12,
        ) {
            let before = picture(|x, y| (x, y), 1.0, 128.0);
            let now = picture(|x, y| (x - dx, y - dy), gain, offset);
            let knobs = FlowKnobs { window_px: 2 * window.max(5) + 1, ..FlowKnobs::default() };
            let mut flow = Flow::new(knobs).unwrap();
            for (x, y) in [(60.3, 50.8), (99.5, 80.0), (140.1, 100.25)] {
                let pixel = Vector2::new(x, y);
                let found = flow.follow(&before, &now, &pixel, &pixel, 3, None);
                let error = found.map(|found| (found.pixel - pixel - Vector2::new(dx, dy)).norm());
                prop_assert!(error.is_some_and(|e| e < 0.06), "{:?} {:?}", found, error);
                prop_assert!(found.unwrap().likeness > 0.99);
            }
        }

        #[test]
        fn a_turn_that_is_known_is_taken_out(angle in -0.6..0.6f64) {
            let centre = Vector2::new(100.0, 80.0);
            let (sin, cos) = angle.sin_cos();
            let turn = Matrix2::new(cos, -sin, sin, cos);
            let before = picture(|x, y| (x, y), 1.0, 128.0);
            // now(p) = before(centre + turn (p − centre))
            let map = |x: f64, y: f64| {
                let p = centre + turn * (Vector2::new(x, y) - centre);
                (p.x, p.y)
            };
            let now = picture(map, 1.0, 128.0);
            let mut flow = Flow::new(FlowKnobs { window_px: 21, ..FlowKnobs::default() }).unwrap();
            let pixel = centre + Vector2::new(3.0, -2.0);
            let goal = centre + turn.transpose() * (pixel - centre);
            let guess = goal + Vector2::new(1.5, -1.0);
            let found = flow.follow(&before, &now, &pixel, &guess, 1, Some(&turn)).unwrap();
            prop_assert!((found.pixel - goal).norm() < 0.1 && found.likeness > 0.99, "{:?} {}", found, goal);
        }
    }

    #[test]
    fn what_has_no_place_has_none() {
        let textured = picture(|x, y| (x, y), 1.0, 128.0);
        let flat = picture(|_, _| (0.0, 0.0), 1.0, 128.0);
        let striped = picture(|x, _| (x, 0.0), 1.0, 128.0);
        let mut flow = Flow::new(FlowKnobs::default()).unwrap();
        let middle = Vector2::new(100.0, 80.0);
        assert_eq!(flow.follow(&flat, &textured, &middle, &middle, 3, None), None);
        assert_eq!(flow.follow(&striped, &striped, &middle, &middle, 3, None), None);
        for bad in [f64::NAN, f64::INFINITY, -1e300, 1e300, -20.0] {
            let pixel = Vector2::new(bad, 80.0);
            assert_eq!(flow.follow(&textured, &textured, &pixel, &middle, 3, None), None);
            assert_eq!(flow.follow(&textured, &textured, &middle, &pixel, 3, None), None);
            let warp = Matrix2::new(bad, 0.0, 0.0, 1.0);
            let found = flow.follow(&textured, &textured, &middle, &middle, 3, Some(&warp));
            assert!(found.is_none_or(|found| found.pixel.x.is_finite()));
        }
    }

    #[test]
    fn corners_and_edges_of_the_picture_are_safe() {
        let textured = picture(|x, y| (x, y), 1.0, 128.0);
        for window_px in [5, 15, 23] {
            let mut flow = Flow::new(FlowKnobs { window_px, ..FlowKnobs::default() }).unwrap();
            for x in [0.0, 0.5, 199.0] {
                for y in [0.0, 0.7, 159.0] {
                    let pixel = Vector2::new(x, y);
                    for guess in [pixel, pixel.add_scalar(7.9), pixel.add_scalar(-7.9)] {
                        let _ = flow.follow(
                            &textured,
                            &textured,
                            &pixel,
                            &guess,
                            3,
                            Some(&Matrix2::new(1.3, 0.4, -0.4, 1.3)),
                        );
                        let _ = flow.follow(&textured, &textured, &pixel, &guess, 3, None);
                    }
                }
            }
        }
    }

    #[test]
    fn knobs_have_ranges() {
        let plain = FlowKnobs::default();
        for bad in [
            FlowKnobs { window_px: 14, ..plain },
            FlowKnobs { window_px: 25, ..plain },
            FlowKnobs { levels: 0, ..plain },
            FlowKnobs { iterations: 0, ..plain },
            FlowKnobs { epsilon_px: f64::NAN, ..plain },
        ] {
            assert!(Flow::new(bad).is_err(), "{bad:?}");
        }
    }
}
