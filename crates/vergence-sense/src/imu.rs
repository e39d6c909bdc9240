use nalgebra::Vector3;

/// One reading of an inertial unit, in its own frame: right-handed axes, whichever way they point on the device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Imu {
    /// Angular rate in radians per second, bias not removed.
    pub gyr_rad_s: Vector3<f64>,
    /// Specific force in metres per second squared: at rest it points up and is about 9.81 long.
    pub acc_m_s2: Vector3<f64>,
    /// Magnetic field in microteslas; `None` where the device has no magnetometer or it had nothing to say.
    pub mag_ut: Option<Vector3<f64>>,
}
