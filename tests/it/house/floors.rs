//! The floors of the house, as ARCHITECTURE.md lists them.

/// Folders that have floors, and these, in the order of ARCHITECTURE.md: each imports itself and those before it. What
/// stands in the folder's own `mod.rs` or `lib.rs` is above all of them.
pub(super) const HOUSES: [House; 5] = [
    House {
        of_crate: "film",
        folder: &[],
        floors: &[
            "hash",
            "packed",
            "lens",
            "light_key",
            "rgb_sum",
            "saliency",
            "tile",
            "portion",
            "film",
            "brightness",
            "filter",
            "coarse",
            "part",
            "display",
            "encode",
            "merge",
        ],
    },
    House {
        of_crate: "render",
        folder: &[],
        floors: &[
            "math",
            "sampler",
            "sampling",
            "stats",
            "threads",
            "trace",
            "voxel",
            "g_stage",
            "shading",
            "scene",
            "photon",
            "integrate",
            "schedule",
            "session",
        ],
    },
    House {
        of_crate: "gpu",
        folder: &[],
        floors: &[
            "words", "adapters", "device", "kernels", "octree", "packing", "units", "slots", "worker",
            "stage",
        ],
    },
    House {
        of_crate: "model",
        folder: &[],
        floors: &[
            "device",
            "options",
            "info",
            "scene_defaults",
            "shared_pool",
            "outline",
            "handle",
            "opening",
            "rays",
            "picture",
            "picture_parts",
            "show",
            "times",
            "ray_rates",
        ],
    },
    House {
        of_crate: "store",
        folder: &["build"],
        floors: &[
            "options",
            "input_sizes",
            "model_materials",
            "phases",
            "report",
            "scan",
            "scratch",
            "journal",
            "partition",
            "clusters",
            "draft",
            "emit",
            "plan",
            "checkpoint",
            "site",
            "shard_file",
            "shard_plan",
            "fragment",
            "shards",
        ],
    },
];

/// A folder whose files and subfolders are floors.
pub(super) struct House {
    pub(super) of_crate: &'static str,
    /// Module path of the folder below the crate.
    pub(super) folder: &'static [&'static str],
    pub(super) floors: &'static [&'static str],
}
