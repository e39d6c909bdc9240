use nalgebra::{Point3, UnitVector3};

/// A half-line: where it starts (metres) and where it goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where it starts, metres.
    pub origin: Point3<f64>,
    /// Where it goes.
    pub direction: UnitVector3<f64>,
}

impl Ray {
    /// The point `distance_m` metres along the ray.
    pub fn at(&self, distance_m: f64) -> Point3<f64> {
        self.origin + self.direction.into_inner() * distance_m
    }
}
