/// An upright rectangle in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Rect {
    pub x: f64,
    pub y: f64,
    pub width: f64,
    pub height: f64,
}

impl Rect {
    pub fn overlaps(&self, other: &Self) -> bool {
        self.x < other.x + other.width
            && other.x < self.x + self.width
            && self.y < other.y + other.height
            && other.y < self.y + self.height
    }

    fn inside(&self, frame: &Self) -> bool {
        self.x >= frame.x
            && self.y >= frame.y
            && self.x + self.width <= frame.x + frame.width
            && self.y + self.height <= frame.y + frame.height
    }
}

/// Puts labels beside their points, one after the other, each in the first place that is free; one that finds none
/// is left out (its point keeps the tooltip).
pub(crate) struct Placer {
    frame: Rect,
    taken: Vec<Rect>,
}

/// Directions that are tried, best first: right above, left above, right below, left below, right, left, above, below.
const PLACES: [(f64, f64); 8] =
    [(1.0, -1.0), (-1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (1.0, 0.0), (-1.0, 0.0), (0.0, -1.0), (0.0, 1.0)];

impl Placer {
    /// Labels stay inside `frame` and off `taken`.
    pub fn new(frame: Rect, taken: Vec<Rect>) -> Self {
        Self { frame, taken }
    }

    /// The free place for a label of the given size beside the point (`x`, `y`), tried at growing distances.
    pub fn place(&mut self, x: f64, y: f64, width: f64, height: f64) -> Option<Rect> {
        for gap in [4.0, 10.0, 18.0] {
            for (right, down) in PLACES {
                let rect = Rect {
                    x: x - 0.5 * width + right * (0.5 * width + gap),
                    y: y - 0.5 * height + down * (0.5 * height + gap),
                    width,
                    height,
                };
                if rect.inside(&self.frame) && !self.taken.iter().any(|taken| taken.overlaps(&rect)) {
                    self.taken.push(rect);
                    return Some(rect);
                }
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_never_overlap_nor_leave_the_frame() {
        let frame = Rect { x: 0.0, y: 0.0, width: 300.0, height: 200.0 };
        let mut placer = Placer::new(frame, vec![Rect { x: 100.0, y: 100.0, width: 20.0, height: 20.0 }]);
        let mut placed = placer.taken.clone();
        for i in 0..60 {
            let (x, y) = (f64::from(i * 37 % 300), f64::from(i * 53 % 200));
            if let Some(rect) = placer.place(x, y, 60.0, 12.0) {
                assert!(rect.inside(&frame) && placed.iter().all(|other| !other.overlaps(&rect)));
                placed.push(rect);
            }
        }
        assert!((10..60).contains(&placed.len()), "{}", placed.len());
    }
}
