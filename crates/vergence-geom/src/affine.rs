use nalgebra::{Matrix3, Matrix4, Point3, UnitQuaternion, Vector3};

use crate::Rigid;

/// An affine transform `p ↦ linear · p + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Affine {
    /// Rotation, scale and shear.
    pub linear: Matrix3<f64>,
    /// In metres.
    pub translation: Vector3<f64>,
}

/// A transform as scene formats animate it: scale first, then rotation, then translation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trs {
    /// In metres.
    pub translation: Vector3<f64>,
    /// A unit quaternion.
    pub rotation: UnitQuaternion<f64>,
    /// Along the axes before rotation; may be zero or negative.
    pub scale: Vector3<f64>,
}

impl Trs {
    /// Leaves everything where it is.
    pub fn identity() -> Self {
        Self {
            translation: Vector3::zeros(),
            rotation: UnitQuaternion::identity(),
            scale: Vector3::repeat(1.0),
        }
    }

    /// The same transform as a matrix and an offset.
    pub fn to_affine(&self) -> Affine {
        let linear = self.rotation.to_rotation_matrix().into_inner() * Matrix3::from_diagonal(&self.scale);
        Affine { linear, translation: self.translation }
    }
}

impl Affine {
    /// Leaves everything where it is.
    pub fn identity() -> Self {
        Self { linear: Matrix3::identity(), translation: Vector3::zeros() }
    }

    /// From a 4×4 matrix whose last row is (0, 0, 0, 1); `None` where it is not, or where an entry is not finite.
    pub fn from_matrix(matrix: &Matrix4<f64>) -> Option<Self> {
        let last_row_is_affine = matrix.row(3) == nalgebra::RowVector4::new(0.0, 0.0, 0.0, 1.0);
        (last_row_is_affine && matrix.iter().all(|entry| entry.is_finite())).then(|| Self {
            linear: matrix.fixed_view::<3, 3>(0, 0).into_owned(),
            translation: matrix.fixed_view::<3, 1>(0, 3).into_owned(),
        })
    }

    /// Where `point` goes.
    pub fn transform_point(&self, point: &Point3<f64>) -> Point3<f64> {
        Point3::from(self.linear * point.coords + self.translation)
    }

    /// The matrix that takes normals along: the cofactors of the linear part, that is its determinant times its
    /// inverse transpose. It needs no division, so it stands any scale that is not zero in two axes; a negative
    /// determinant (a mirror) turns the normal with the surface. The result is not of unit length.
    pub fn normal_matrix(&self) -> Matrix3<f64> {
        let (x, y, z) = (self.linear.column(0), self.linear.column(1), self.linear.column(2));
        Matrix3::from_columns(&[y.cross(&z), z.cross(&x), x.cross(&y)])
    }

    /// The transform that undoes this one; `None` where the linear part is singular.
    pub fn try_inverse(&self) -> Option<Self> {
        let linear = self.linear.try_inverse()?;
        Some(Self { linear, translation: -(linear * self.translation) })
    }
}

impl From<Rigid> for Affine {
    fn from(rigid: Rigid) -> Self {
        Self {
            linear: rigid.rotation.to_rotation_matrix().into_inner(),
            translation: rigid.translation.vector,
        }
    }
}

impl std::ops::Mul for Affine {
    type Output = Self;

    fn mul(self, right: Self) -> Self {
        Self {
            linear: self.linear * right.linear,
            translation: self.linear * right.translation + self.translation,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_product_applies_right_to_left() {
        let a = Trs { scale: Vector3::new(2.0, 1e-3, -1.0), ..Trs::identity() }.to_affine();
        let b = Affine { translation: Vector3::new(1.0, 2.0, 3.0), ..Affine::identity() };
        let p = Point3::new(0.25, -4.0, 1e6);
        assert_eq!((a * b).transform_point(&p), a.transform_point(&b.transform_point(&p)));
    }

    /// Row 21 of the extremes: a flattened surface keeps its normal to 1e-6 rad (here, in f64, to 1e-15).
    #[test]
    fn normals_stay_perpendicular_under_uneven_and_negative_scale() {
        let rotation = UnitQuaternion::from_euler_angles(0.3, -1.1, 2.0);
        for scale in
            [Vector3::new(1.0, 1e-3, 1.0), Vector3::new(-1.0, 1.0, 1.0), Vector3::new(1e3, 1e-3, -2.0)]
        {
            let a = Trs { rotation, scale, ..Trs::identity() }.to_affine();
            let (u, v) = (Vector3::new(1.0, 2.0, -0.5), Vector3::new(0.1, -1.0, 3.0));
            let normal = (a.normal_matrix() * u.cross(&v)).normalize();
            let truth = (a.linear * u).cross(&(a.linear * v)).normalize();
            assert!(
                normal.cross(&truth).norm() < 1e-14 && normal.dot(&truth) > 0.0,
                "{scale}: {normal} {truth}"
            );
        }
    }
}
