//! `Picture`: a scene rendered to its end, at leisure, with all of its light.

use crate::handle::{Model, Session};
use std::io::{self, Seek, Write};
use std::ops::ControlFlow;
use trex_render::{Film, PhotonStats, RenderStats, Scene, write_exr, write_png};
use trex_store::{Interrupt, Progress, Report, Result};

/// A rendered picture, with the session that made it.
pub struct Picture {
    session: Session,
    exposure: f32,
    /// Photons that were sent.
    pub photons: PhotonStats,
    /// Rays and passes.
    pub stats: RenderStats,
}

impl Model {
    /// Renders what `scene` describes, as [`Model::session`] does: photons, all samples, the filter.
    ///
    /// # Errors
    /// Those of [`Model::session`] and [`Model::check_damage`]; [`trex_store::Code::Interrupted`].
    pub fn render(&self, scene: &Scene, interrupt: &Interrupt, report: Report<'_>) -> Result<Picture> {
        let mut session = self.session(scene)?;
        let stop = || interrupt.is_raised();
        let tell = |phase, unit, [done, total]: [u64; 2]| {
            report(Progress { phase, done, total, unit, memory_bytes: self.budget().used_bytes() });
        };
        let photons =
            session.illuminate(&stop, &mut |done, total| tell("photons", "photons", [done, total]))?;
        let keys = *session.view().settings;
        let pixels = u64::from(keys.resolution[0]) * u64::from(keys.resolution[1]);
        let stats = session.render(keys.spp, &stop, &mut |_, stats| {
            tell("render", "samples", [u64::from(stats.spp) * pixels, u64::from(keys.spp) * pixels]);
            ControlFlow::Continue(())
        });
        interrupt.check()?;
        self.check_damage()?;
        session.smooth()?;
        Ok(Picture { session, exposure: keys.exposure.factor(), photons, stats })
    }
}

impl Picture {
    /// The film: linear radiance, and layers.
    pub fn film(&self) -> &Film {
        self.session.film()
    }

    /// The session, for further pictures.
    pub fn into_session(self) -> Session {
        self.session
    }

    /// Writes it as PNG, sRGB, with the exposure of its scene.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn write_png(&self, out: impl Write) -> io::Result<()> {
        write_png(self.film(), self.exposure, self.session.thread_pool(), out)
    }

    /// Writes it as EXR, linear, with the layers that its film keeps.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn write_exr(&self, out: impl Write + Seek) -> io::Result<()> {
        write_exr(self.film(), out)
    }
}
