use std::path::PathBuf;

/// Why a scene could not be run.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// What was asked for cannot be done here, or makes no sense.
    #[error("{0}")]
    Call(String),
    /// No headset, or no longer.
    #[error(transparent)]
    Headset(#[from] vergence_xr::Error),
    /// The simulated headset cannot be so.
    #[error(transparent)]
    Simulated(#[from] vergence_xr_sim::Error),
    /// The scene cannot be drawn.
    #[error(transparent)]
    Render(#[from] vergence_render::Error),
    /// Vulkan failed.
    #[error(transparent)]
    Gpu(#[from] vergence_gpu::Error),
    /// There is no window.
    #[error(transparent)]
    Window(#[from] vergence_window::Error),
    /// A session log cannot be read.
    #[error(transparent)]
    Log(#[from] vergence_log::Error),
    /// A recording cannot be followed.
    #[error(transparent)]
    Odometry(#[from] vergence_slam::Error),
    /// A log in which no rig was recorded.
    #[error("{}: expected a log of a rig (metadata vergence.rig, as `vergence log import euroc` writes it), found none", path.display())]
    NoRig {
        /// The log.
        path: PathBuf,
    },
    /// What is needed could not be read.
    #[error("{path}: cannot be read: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A result could not be written.
    #[error("{path}: cannot be written: {source}")]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Nothing has happened for too long.
    #[error("no frame was shown for {waited_s} s ({state}); giving up")]
    Stalled {
        /// Seconds.
        waited_s: u64,
        /// What the headset was doing.
        state: &'static str,
    },
}

impl Error {
    /// Whether the call was wrong, or asks for what this machine cannot give (exit status 2), rather than the work
    /// having failed.
    pub const fn is_wrong_call(&self) -> bool {
        matches!(
            self,
            Self::Call(_)
                | Self::Headset(vergence_xr::Error::RefreshRate { .. })
                | Self::Headset(vergence_xr::Error::Gpu(vergence_gpu::Error::NoSuchDevice { .. }))
                | Self::Simulated(
                    vergence_xr_sim::Error::Config(_)
                        | vergence_xr_sim::Error::Unknown { .. }
                        | vergence_xr_sim::Error::Trajectory { .. }
                        | vergence_xr_sim::Error::Tum { .. }
                )
                | Self::Window(_)
                | Self::Render(vergence_render::Error::Range { .. })
                | Self::Render(vergence_render::Error::Gpu(vergence_gpu::Error::Unsupported { .. }))
                | Self::Gpu(
                    vergence_gpu::Error::Unsupported { .. } | vergence_gpu::Error::NoSuchDevice { .. }
                )
        )
    }

    /// Whether the graphics device does not finish its work.
    pub(crate) const fn is_stuck_device(&self) -> bool {
        matches!(
            self,
            Self::Gpu(vergence_gpu::Error::Timeout { .. })
                | Self::Render(vergence_render::Error::Gpu(vergence_gpu::Error::Timeout { .. }))
        )
    }

    pub(crate) fn read(path: &std::path::Path) -> impl Fn(std::io::Error) -> Self + '_ {
        move |source| Self::Read { path: path.to_owned(), source }
    }

    pub(crate) fn write(path: &std::path::Path) -> impl Fn(std::io::Error) -> Self + '_ {
        move |source| Self::Write { path: path.to_owned(), source }
    }
}

/// An error and what caused it, in one sentence.
pub(crate) fn with_cause(error: &dyn std::error::Error) -> String {
    match error.source() {
        Some(cause) => format!("{error}: {}", with_cause(cause)),
        None => error.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_motion_that_cannot_be_understood_is_a_wrong_call_and_a_file_that_cannot_be_read_is_none() {
        let wrong = vergence_xr_sim::motion::parse_tum(std::path::Path::new("way.txt"), "0 0 0").err();
        assert!(wrong.is_some_and(|error| Error::from(error).is_wrong_call()));
        let scene = vergence_scene::Scene { files: vec!["/no/such/scene.glb".into()], ..Default::default() };
        let failed = crate::provenance::scene_hash(&scene).err();
        assert!(failed.is_some_and(|error| error.to_string().contains("scene.glb: cannot be read")));
    }
}
