//! What a frame says: where tracked corners are seen.

use nalgebra::{Matrix2x3, Matrix3, Matrix3x2, SMatrix, Vector2, Vector3};
use vergence_geom::{Lens, Rigid};

/// One tracked corner in one picture. Directions instead of pixels: the estimator knows no lens, and a wide lens is
/// nothing special.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// The same number for the same corner in every camera and frame.
    pub track: u64,
    /// Which camera of the rig.
    pub camera: u8,
    /// Direction to the corner, of length 1, in the camera's frame (x right, y down, z forward).
    pub direction: Vector3<f64>,
    /// How the pixel moves with the direction (its product with `direction` is zero).
    pub px_by_direction: Matrix2x3<f64>,
    /// Distance along z to the corner, m, where a depth camera says it.
    pub depth_m: Option<f64>,
}

impl Sighting {
    /// Of a pixel seen through a lens; `None` outside of the lens' domain.
    pub fn new(track: u64, camera: u8, pixel: &Vector2<f64>, lens: &Lens) -> Option<Self> {
        let direction = lens.unproject(pixel)?.into_inner();
        let (_, px_by_direction) = lens.project_with_jacobian(&direction)?;
        let fine = px_by_direction.iter().all(|x| x.is_finite());
        fine.then_some(Self { track, camera, direction, px_by_direction, depth_m: None })
    }

    /// One over the distance along the line of sight, 1/m, where it is measured.
    pub(crate) fn inverse_range(&self) -> Option<f64> {
        self.depth_m.filter(|z| *z > 0.0 && z.is_finite()).map(|z| self.direction.z / z)
    }
}

/// Two unit vectors across `direction`, which make a right-handed frame with it.
pub(crate) fn across(direction: &Vector3<f64>) -> Matrix3x2<f64> {
    let helper = if direction.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
    let first = direction.cross(&helper).normalize();
    Matrix3x2::from_columns(&[first, direction.cross(&first)])
}

/// How a direction in the host camera comes to be seen by another camera: `along · direction + inverse distance · offset`
/// is the point in that camera, times the inverse distance. Points at infinity are nothing special.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Way {
    pub(crate) along: Matrix3<f64>,
    pub(crate) offset: Vector3<f64>,
    /// From the host camera to the target's body, rotation and translation part, before the step into the camera.
    body_along: Matrix3<f64>,
    body_offset: Vector3<f64>,
    camera_from_body: Matrix3<f64>,
}

impl Way {
    /// From the host's camera by the bodies' relative pose to the target's camera.
    pub(crate) fn new(
        target_from_host: &Rigid,
        host_from_camera: &Rigid,
        target_from_target_camera: &Rigid,
    ) -> Self {
        let rotation = target_from_host.rotation.to_rotation_matrix().into_inner();
        let host_camera = host_from_camera.rotation.to_rotation_matrix().into_inner();
        let camera_from_body = target_from_target_camera.rotation.inverse().to_rotation_matrix().into_inner();
        let body_along = rotation * host_camera;
        let body_offset = rotation * host_from_camera.translation.vector;
        let moved =
            body_offset + target_from_host.translation.vector - target_from_target_camera.translation.vector;
        Self {
            along: camera_from_body * body_along,
            offset: camera_from_body * moved,
            body_along,
            body_offset,
            camera_from_body,
        }
    }

    /// The point in the target camera times the inverse distance.
    #[inline]
    pub(crate) fn carry(&self, direction: &Vector3<f64>, inverse_distance: f64) -> Vector3<f64> {
        self.along * direction + self.offset * inverse_distance
    }

    /// Residual in pixels; `None` behind the camera.
    #[inline]
    pub(crate) fn residual(
        &self,
        seen: &Sighting,
        direction: &Vector3<f64>,
        inverse_distance: f64,
    ) -> Option<Vector2<f64>> {
        let carried = self.carry(direction, inverse_distance);
        let length = carried.norm();
        (carried.dot(&seen.direction) > 0.1 * length).then(|| seen.px_by_direction * carried / length)
    }

    /// Derivatives of the residual by the relative pose (translation, rotation; perturbed on the left, in the target's body)
    /// and by the point (two of the direction across `basis`, inverse distance).
    #[inline]
    pub(crate) fn derivatives(
        &self,
        seen: &Sighting,
        direction: &Vector3<f64>,
        basis: &Matrix3x2<f64>,
        inverse_distance: f64,
    ) -> (SMatrix<f64, 2, 6>, SMatrix<f64, 2, 3>) {
        let carried = self.carry(direction, inverse_distance);
        let length = carried.norm().max(1e-12);
        let unit = carried / length;
        let by_carried = (seen.px_by_direction - (seen.px_by_direction * unit) * unit.transpose()) / length;
        self.chain(&by_carried, direction, basis, inverse_distance)
    }

    /// Of the inverse range (1/m) that the target camera sees: value, and derivatives as of [`Self::derivatives`].
    pub(crate) fn inverse_range(
        &self,
        direction: &Vector3<f64>,
        basis: &Matrix3x2<f64>,
        inverse_distance: f64,
    ) -> (f64, SMatrix<f64, 1, 6>, SMatrix<f64, 1, 3>) {
        let carried = self.carry(direction, inverse_distance);
        let length = carried.norm().max(1e-12);
        let by_carried = carried.transpose() * (-inverse_distance / length.powi(3));
        let (by_pose, mut by_point) = self.chain(&by_carried, direction, basis, inverse_distance);
        by_point[2] += 1.0 / length;
        (inverse_distance / length, by_pose, by_point)
    }

    #[inline]
    fn chain<const D: usize>(
        &self,
        by_carried: &SMatrix<f64, D, 3>,
        direction: &Vector3<f64>,
        basis: &Matrix3x2<f64>,
        inverse_distance: f64,
    ) -> (SMatrix<f64, D, 6>, SMatrix<f64, D, 3>) {
        let in_body = by_carried * self.camera_from_body;
        let turned = self.body_along * direction + self.body_offset * inverse_distance;
        let mut by_pose = SMatrix::<f64, D, 6>::zeros();
        by_pose.fixed_columns_mut::<3>(0).copy_from(&(in_body * inverse_distance));
        by_pose.fixed_columns_mut::<3>(3).copy_from(&(in_body * -turned.cross_matrix()));
        let mut by_point = SMatrix::<f64, D, 3>::zeros();
        by_point.fixed_columns_mut::<2>(0).copy_from(&(by_carried * self.along * basis));
        by_point.fixed_columns_mut::<1>(2).copy_from(&(by_carried * self.offset));
        (by_pose, by_point)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{SVector, Translation3};
    use proptest::prelude::*;
    use vergence_geom::exp;
    use vergence_solve::numeric;

    use super::*;

    fn rigid(v: &[f64]) -> Rigid {
        Rigid::from_parts(Translation3::new(v[0], v[1], v[2]), exp(&Vector3::new(v[3], v[4], v[5])))
    }

    proptest! {
        #[test]
        fn derivatives_are_the_numerical_ones(v in proptest::collection::vec(-0.3..0.3f64, 24), near in 0.0..1.5f64) {
            let lens = Lens::pinhole([458.0, 457.0], [376.0, 240.0]).unwrap();
            let (relative, host, target) = (rigid(&v[0..6]), rigid(&v[6..12]), rigid(&v[12..18]));
            let direction = Vector3::new(v[18], v[19], 1.0).normalize();
            let basis = across(&direction);
            let way = Way::new(&relative, &host, &target);
            let carried = way.carry(&direction, near);
            prop_assume!(carried.z > 0.2);
            let pixel = lens.project(&carried).unwrap() + Vector2::new(v[20], v[21]) * 20.0;
            let seen = Sighting::new(0, 0, &pixel, &lens).unwrap();
            let moved = |by: &SVector<f64, 6>| {
                let shift = by.fixed_rows::<3>(0).into_owned();
                let turned = exp(&by.fixed_rows::<3>(3).into_owned());
                let relative = Rigid::from_parts((relative.translation.vector + shift).into(), relative.rotation);
                Way::new(&Rigid::from_parts(relative.translation, turned * relative.rotation), &host, &target)
            };
            let point = |by: &SVector<f64, 3>| ((direction + basis * by.fixed_rows::<2>(0)).normalize(), near + by.z);
            let (by_pose, by_point) = way.derivatives(&seen, &direction, &basis, near);
            let numeric_pose = numeric::jacobian(1e-4, |by| moved(by).residual(&seen, &direction, near).unwrap());
            let numeric_point = numeric::jacobian(1e-4, |by| { let (d, r) = point(by); way.residual(&seen, &d, r).unwrap() });
            prop_assert!(numeric::error(&by_pose, &numeric_pose) < 1e-7);
            prop_assert!(numeric::error(&by_point, &numeric_point) < 1e-7);
            let (_, by_pose, by_point) = way.inverse_range(&direction, &basis, near);
            let range = |way: &Way, d: &Vector3<f64>, r: f64| SVector::<f64, 1>::new(way.inverse_range(d, &across(d), r).0);
            let numeric_pose = numeric::jacobian(1e-4, |by| range(&moved(by), &direction, near));
            let numeric_point = numeric::jacobian(1e-4, |by| { let (d, r) = point(by); range(&way, &d, r) });
            prop_assert!(numeric::error(&by_pose, &numeric_pose) < 1e-7);
            prop_assert!(numeric::error(&by_point, &numeric_point) < 1e-7);
            // The residual is that of the pixels, but for the second order.
            let exact = lens.project(&carried).unwrap() - pixel;
            let found = way.residual(&seen, &direction, near).unwrap();
            prop_assert!((exact - found).norm() < 0.05 * exact.norm() + 1e-9, "{} {}", exact, found);
        }
    }
}
