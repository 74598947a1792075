//! The triangles of a file as peers and oracles take them.

use trex_store::PageFile;
use trex_store::cluster::FrameView;
use trex_store::layout::{FRAME_BYTES, PageKind};

/// All triangles of a file in the order of their ids, lattice coordinates. Its unit pages hold none.
pub(crate) fn decode(file: &PageFile) -> trex_store::Result<Vec<[[i32; 3]; 3]>> {
    let mut triangles = Vec::with_capacity(file.superblock().triangle_count as usize);
    // Frames are read through words: their alignment is what nodes need.
    let mut frame = vec![0u64; FRAME_BYTES / 8];
    let mut buffers = [Vec::new(), Vec::new()];
    let pages = (0u32..).zip(file.pages());
    for (page, _) in pages.filter(|(_, entry)| entry.kind == PageKind::Mesh) {
        file.read_page(page, bytemuck::cast_slice_mut(&mut frame), &mut buffers)?;
        FrameView::new(bytemuck::cast_slice(&frame)).for_each_cluster(|cluster| {
            let mesh = cluster.decode();
            let corner = |index: u8| mesh.vertices[usize::from(index)].map(|q| q as i32);
            triangles.extend(mesh.triangles.iter().map(|corners| corners.map(corner)));
        });
    }
    Ok(triangles)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Model;
    use trex_store::Budget;
    use trex_store::build::Voxels;
    use trex_store::octree::Refinement;

    /// Unit pages were once decoded as clusters: a panic on every file with lower octrees.
    #[test]
    fn a_file_with_units_has_the_triangles_that_it_says() {
        let folder = tempfile::tempdir().unwrap();
        let voxels = Voxels::Refined { upper: 64, refinement: Refinement::By4 };
        let model = Model::for_bench("gen:pipes:20k:3", voxels, folder.path().to_owned());
        let file = PageFile::open(&model.path, &Budget::unlimited()).unwrap();
        let has_units = file.pages().iter().any(|page| page.kind == PageKind::Units);
        assert!(has_units, "a file without units tests nothing");
        assert_eq!(decode(&file).unwrap().len() as u64, file.superblock().triangle_count);
    }
}
