//! The end of a file: all that is made of more than one chunk.
//!
//! ```text
//! the page that chunks share | voxel records -> pages of units | tables, sections of the octree | superblocks
//! ```
//!
//! Invariant: it knows neither scratch files nor workers, so that chunks of any making end in the same bytes.

use super::voxels::VoxelMerge;
use super::writer::PageWriter;
use crate::build::draft::DraftFile;
use crate::build::model_materials::ModelMaterials;
use crate::build::options::BuildOptions;
use crate::build::phases::PhaseClock;
use crate::build::report::{BuildReport, PhaseReport};
use crate::error::Result;
use crate::layout::Superblock;
use crate::octree::FirstPage;

/// What is written behind the chunks.
pub(crate) struct FinishWork<'a> {
    /// It has all chunks.
    pub(crate) writer: PageWriter<'a>,
    pub(crate) materials: &'a ModelMaterials,
    /// Of a model that gets an octree.
    pub(crate) voxels: Option<VoxelMerge<'a>>,
    pub(crate) options: &'a BuildOptions,
    pub(crate) report: PhaseReport<'a>,
}

/// Writes the end of a file whose chunks are written.
pub(crate) fn finish(
    work: FinishWork<'_>,
    mut file: DraftFile<'_>,
    out: &mut BuildReport,
) -> Result<Superblock> {
    let FinishWork { mut writer, materials, voxels, options, report } = work;
    writer.close(&mut file)?;

    // Records merged into the octree; pages of units.
    let mut clock = PhaseClock::start();
    let merged = match voxels {
        None => None,
        Some(work) => {
            let shape = work.shape;
            (out.upper_resolution, out.finest_resolution) =
                (shape.grid.resolution, shape.finest().resolution);
            let report = |done| report("voxels", "records", done, 0);
            let pages = FirstPage { number: writer.page_count(), material_count: materials.count() };
            let put = &mut |raw| writer.add_units(raw, &mut file);
            Some(work.run(pages, put, &options.budget, &report)?)
        }
    };

    // Tables, then the sections of the octree.
    writer.write_tables(&mut file, materials, &options.budget)?;
    if let Some(merged) = merged {
        out.scratch_peak_bytes = out.scratch_peak_bytes.max(merged.scratch_bytes);
        out.lower_leaf_count = merged.lower_leaf_count();
        out.upper_leaf_count = merged.write(&mut file, writer.file_id(), writer.voxel_sections())?;
    }
    (out.phase_ms.voxels, out.phase_cpu_ms.voxels) = clock.lap();

    // Both superblocks.
    writer.seal(&mut file, out)
}
