//! What stages count: rays by kind, what a pass did, what photons did.
//!
//! Invariant: counts of workers, passes and frames add up with `add`, all but `tiles_left`, which is the last one's.

/// The purpose of a ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RayKind {
    Primary,
    Mirror,
    Shadow,
    Gather,
}

/// Rays answered, by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct RayCounts {
    /// Rays from the camera.
    pub primary: u64,
    /// Perfect mirror bounces.
    pub mirror: u64,
    /// Rays towards lights.
    pub shadow: u64,
    /// Rays that gather light by chance: bounces of `path`, gather rays of photon mapping, rays of `ao`.
    pub gather: u64,
    /// Rays of photons; these are no part of a sample.
    pub photon: u64,
}

impl RayCounts {
    /// Counts a ray more.
    pub(crate) fn count(&mut self, kind: RayKind) {
        *match kind {
            RayKind::Primary => &mut self.primary,
            RayKind::Mirror => &mut self.mirror,
            RayKind::Shadow => &mut self.shadow,
            RayKind::Gather => &mut self.gather,
        } += 1;
    }

    /// Adds another count.
    pub fn add(&mut self, other: &RayCounts) {
        self.primary += other.primary;
        self.mirror += other.mirror;
        self.shadow += other.shadow;
        self.gather += other.gather;
        self.photon += other.photon;
    }

    /// Count of rays of all kinds together.
    pub fn total(&self) -> u64 {
        self.primary + self.mirror + self.shadow + self.gather + self.photon
    }
}

/// Counts of the G-stage: rays that asked the voxels in batches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct GStats {
    /// Batches that were answered.
    pub batches: u64,
    /// Shadow rays.
    pub shadow: u64,
    /// Gather rays.
    pub gather: u64,
    /// C-rays behind the cut of the footprint rule.
    pub far: u64,
    /// Bytes of rays that went in.
    pub bytes_in: u64,
    /// Bytes of answers that came out.
    pub bytes_out: u64,
    /// Time of all workers in the stage, ns.
    pub time_ns: u64,
    /// Most tiles that waited for the stage.
    pub queue_peak: u64,
}

impl GStats {
    /// Adds another worker, pass or frame.
    pub fn add(&mut self, other: &GStats) {
        self.batches += other.batches;
        self.shadow += other.shadow;
        self.gather += other.gather;
        self.far += other.far;
        self.bytes_in += other.bytes_in;
        self.bytes_out += other.bytes_out;
        self.time_ns += other.time_ns;
        self.queue_peak = self.queue_peak.max(other.queue_peak);
    }
}

/// Counts of a pass.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct PassStats {
    /// Rays of finished samples.
    pub rays: RayCounts,
    /// The G-stage.
    pub g_stage: GStats,
    /// Look-ups of photons of finished samples.
    pub look_ups: u64,
    /// Samples that reached the film.
    pub samples: u64,
    /// Of these, samples whose ray from the camera met the model.
    pub covered_samples: u64,
    /// Times that a tile had to be parked.
    pub parked: u64,
    /// Times that a worker waited for pages.
    pub waits: u64,
    /// Samples that had to be taken alone since their pages did not fit together.
    pub narrow_samples: u64,
    /// Samples whose radiance was not finite (light values near the end of f32); they count as black.
    pub not_finite: u64,
    /// Tiles whose samples reached the film.
    pub tiles_finished: u64,
    /// Tiles that have not had their samples yet.
    pub tiles_left: u64,
}

impl PassStats {
    /// Adds another pass or worker.
    pub fn add(&mut self, other: &PassStats) {
        self.rays.add(&other.rays);
        self.g_stage.add(&other.g_stage);
        self.look_ups += other.look_ups;
        self.samples += other.samples;
        self.covered_samples += other.covered_samples;
        self.parked += other.parked;
        self.waits += other.waits;
        self.narrow_samples += other.narrow_samples;
        self.not_finite += other.not_finite;
        self.tiles_finished += other.tiles_finished;
        self.tiles_left = other.tiles_left;
    }
}

/// Counts of photon tracing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct PhotonStats {
    /// Photons sent.
    pub photons: u64,
    /// Rays that the photons took.
    pub rays: u64,
    /// Hits whose flux was kept: added to a side of a facet, or stored as a photon of `full-gi`.
    pub deposits: u64,
    /// Hits whose flux found no place.
    pub lost: u64,
    /// Times that a worker waited for pages.
    pub waits: u64,
}

impl PhotonStats {
    /// Adds another worker or pass.
    pub fn add(&mut self, other: &PhotonStats) {
        self.photons += other.photons;
        self.rays += other.rays;
        self.deposits += other.deposits;
        self.lost += other.lost;
        self.waits += other.waits;
    }
}
