//! The choices of a picture: `Method`, the way in which light is computed, and what G-rays and filters do.
//!
//! Invariant: each choice has one name, which scene files, flags and pages share; `keys` says what it means.

/// The way in which light is computed: the integrator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Direct light and perfect mirrors: see `integrate/direct.rs`.
    #[default]
    Direct,
    /// All light but suns and points over mirrors, unbiased: see `integrate/path.rs`.
    Path,
    /// Ambient occlusion: see `integrate/ao.rs`.
    Ao,
    /// Photon mapping on voxels: see `integrate/photon.rs`. Also called `cpu-gi`: all of it runs on the CPU.
    #[serde(alias = "cpu-gi")]
    Photon,
    /// Photon mapping on the exact mesh: see `integrate/final_gather.rs`.
    FullGi,
    /// The leaves of the voxel octree: see `integrate/debug.rs`.
    DebugUpper,
    /// The finest voxels, through the units below it.
    DebugLower,
    /// The bitmaps of the resident octree.
    DebugOccluders,
    /// The pages of the mesh.
    DebugPages,
}

impl Method {
    /// All of them.
    pub const ALL: [Method; 9] = [
        Method::Direct,
        Method::Path,
        Method::Ao,
        Method::Photon,
        Method::FullGi,
        Method::DebugUpper,
        Method::DebugLower,
        Method::DebugOccluders,
        Method::DebugPages,
    ];

    /// The name as typed.
    pub fn as_str(self) -> &'static str {
        match self {
            Method::Direct => "direct",
            Method::Path => "path",
            Method::Ao => "ao",
            Method::Photon => "photon",
            Method::FullGi => "full-gi",
            Method::DebugUpper => "debug-upper",
            Method::DebugLower => "debug-lower",
            Method::DebugOccluders => "debug-occluders",
            Method::DebugPages => "debug-pages",
        }
    }

    /// True when nothing can be drawn without voxels.
    pub fn needs_voxels(self) -> bool {
        self == Method::Photon || self.shows_voxels()
    }

    /// True when C-rays show voxels, not the mesh.
    pub(crate) fn shows_voxels(self) -> bool {
        matches!(self, Method::DebugUpper | Method::DebugLower | Method::DebugOccluders)
    }

    /// True when there is light to compute: all but the debug views.
    pub(crate) fn computes_light(self) -> bool {
        !self.shows_voxels() && self != Method::DebugPages
    }

    /// True when indirect light is gathered from photons.
    pub fn gathers(self) -> bool {
        matches!(self, Method::Photon | Method::FullGi)
    }

    /// True when the picture that frames show at once is of this method, too: what gathers on the mesh, or goes on by
    /// chance, is seen in direct light at first.
    pub(crate) fn has_own_preview(self) -> bool {
        !matches!(self, Method::Path | Method::FullGi)
    }

    /// True when voxels are asked where there are any.
    pub fn asks_voxels(self) -> bool {
        self.needs_voxels() || self == Method::Ao
    }
}

/// The way in which shadow and gather rays leave a surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Near {
    /// Rays begin off the surface by a voxel.
    Voxel,
    /// Rays begin off the surface by a voxel, but where that is within the voxel of another surface: there they begin
    /// on the exact mesh, for some leaves' length.
    #[default]
    Contact,
    /// Rays begin on the exact mesh, for some leaves' length.
    Exact,
}

impl Near {
    /// The name as typed.
    pub fn as_str(self) -> &'static str {
        match self {
            Near::Voxel => "voxel",
            Near::Contact => "contact",
            Near::Exact => "exact",
        }
    }
}

/// What decides whether a light is hidden from a surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Shadows {
    /// The voxels alone.
    Voxel,
    /// The voxels where they are free: the surface lies within them. Where a voxel is met, the exact mesh.
    #[default]
    Mesh,
}

impl Shadows {
    /// The name as typed.
    pub fn as_str(self) -> &'static str {
        match self {
            Shadows::Voxel => "voxel",
            Shadows::Mesh => "mesh",
        }
    }
}

/// The lamps of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LightRig {
    /// Decided once, by what the opening view shows in the light of the model's own lamps ([`crate::Brightness`]). A
    /// session has it decided before its first picture, see `trex_model`; until then it is [`LightRig::Scene`].
    Auto,
    /// Those of scene and model; where neither has any, a sun and a sky.
    #[default]
    Scene,
    /// Those of scene and model, with that sun and that sky beside them.
    Studio,
}

impl LightRig {
    /// The name as typed.
    pub fn as_str(self) -> &'static str {
        match self {
            LightRig::Auto => "auto",
            LightRig::Scene => "scene",
            LightRig::Studio => "studio",
        }
    }
}

/// Which way is up in a model: where the sun of models without lights stands, and how a camera that frames the model is
/// held.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum UpAxis {
    /// As the model's box says: [`crate::up_axis`].
    #[default]
    #[serde(rename = "auto")]
    Auto,
    /// Along x.
    #[serde(rename = "+X")]
    XUp,
    /// Against x.
    #[serde(rename = "-X")]
    XDown,
    /// Along y.
    #[serde(rename = "+Y")]
    YUp,
    /// Against y.
    #[serde(rename = "-Y")]
    YDown,
    /// Along z.
    #[serde(rename = "+Z")]
    ZUp,
    /// Against z.
    #[serde(rename = "-Z")]
    ZDown,
}

impl UpAxis {
    /// The name as typed.
    pub fn as_str(self) -> &'static str {
        match self {
            UpAxis::Auto => "auto",
            UpAxis::XUp => "+X",
            UpAxis::XDown => "-X",
            UpAxis::YUp => "+Y",
            UpAxis::YDown => "-Y",
            UpAxis::ZUp => "+Z",
            UpAxis::ZDown => "-Z",
        }
    }

    /// The direction, of unit length; `None` where the model's box decides.
    pub fn direction(self) -> Option<[f64; 3]> {
        match self {
            UpAxis::Auto => None,
            UpAxis::XUp => Some([1.0, 0.0, 0.0]),
            UpAxis::XDown => Some([-1.0, 0.0, 0.0]),
            UpAxis::YUp => Some([0.0, 1.0, 0.0]),
            UpAxis::YDown => Some([0.0, -1.0, 0.0]),
            UpAxis::ZUp => Some([0.0, 0.0, 1.0]),
            UpAxis::ZDown => Some([0.0, 0.0, -1.0]),
        }
    }
}

/// Smoothing of indirect light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Filter {
    /// Light is shown as the samples come.
    #[default]
    Off,
    /// Light is smoothed where the pixels show the same surface.
    On,
}

impl Filter {
    /// The name as typed.
    pub fn as_str(self) -> &'static str {
        match self {
            Filter::Off => "off",
            Filter::On => "on",
        }
    }
}
