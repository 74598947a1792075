//! What the tests of several files share.

use crate::lens::{Eye, Lens};
use glam::DVec3;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::sync::Arc;

/// A pool of so many threads.
pub(crate) fn pool(threads: usize) -> Arc<ThreadPool> {
    Arc::new(ThreadPoolBuilder::new().num_threads(threads).build().unwrap())
}

/// A pinhole at `position` that looks at `target`, +y up.
pub(crate) struct Pinhole {
    pub(crate) position: DVec3,
    pub(crate) target: DVec3,
    /// Angle across, degrees.
    pub(crate) fov_x: f64,
    pub(crate) resolution: [u32; 2],
}

impl Pinhole {
    /// Half of the width of the picture at distance 1.
    fn half(&self) -> f64 {
        (0.5 * self.fov_x).to_radians().tan()
    }

    /// The same as plain numbers.
    pub(crate) fn eye(&self) -> Eye {
        let forward = (self.target - self.position).normalize();
        let right = self.half() * forward.cross(DVec3::Y).normalize();
        let [width, height] = self.resolution.map(f64::from);
        let down = height / width * forward.cross(right);
        Eye {
            position: self.position.into(),
            forward: forward.into(),
            right: right.into(),
            down: down.into(),
            resolution: self.resolution,
        }
    }
}

impl Lens for Pinhole {
    fn direction(&self, x: f64, y: f64) -> [f64; 3] {
        let forward = (self.target - self.position).normalize();
        let right = forward.cross(DVec3::Y).normalize();
        let [width, height] = self.resolution.map(f64::from);
        let across = self.half() * (2.0 * x / width - 1.0);
        let down = self.half() * (2.0 * y - height) / width;
        (forward + across * right + down * forward.cross(right)).normalize().into()
    }

    fn pixel_angle(&self) -> f64 {
        2.0 * self.half() / f64::from(self.resolution[0])
    }
}
