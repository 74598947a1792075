//! `PictureParts`: the part files of a picture, checked to be all of it; and what a session states of the part that it
//! has rendered.
//!
//! ```text
//! session of a portion -> part_head -> write_part           on many machines
//! part files -> PictureParts::open -> strips -> a picture   on one
//! ```
//!
//! Invariants: 1. parts of one picture share every fact that decides a sample: the file, the settings, lamps,
//! materials, what is shown, the device and the version; 2. each sample of each tile is in exactly one of the parts
//! that open; 3. no more than one head is kept.

use crate::handle::{Model, Session};
use rayon::ThreadPool;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use trex_render::{
    Camera, MergeSetup, MergedStrips, Misfit, PartDifference, PartFile, PartHead, Portion, Projection,
    digest, merge_bytes, misfit, tile_count,
};
use trex_store::printable::one_line;
use trex_store::{Budget, Code, Error, Interrupt, Result, open_regular};

/// Most parts of a picture.
const PARTS_MAX: usize = 1 << 12;

/// A picture that is merged from files.
pub type MergedFiles<'a> = MergedStrips<'a, BufReader<File>>;

/// The parts of a picture.
#[derive(Debug)]
pub struct PictureParts {
    /// Of the part that was named first.
    head: PartHead,
    /// Each part, its portion and the hash of its head.
    parts: Vec<(PathBuf, Portion, u64)>,
    lens: Projection,
    damaged_page_count: u32,
}

/// What a part file says of the `portion` of a picture that `session` on `model` has rendered.
pub fn part_head(model: &Model, session: &Session, portion: Portion) -> PartHead {
    let view = session.view();
    let settings = *view.settings;
    let device = model.device();
    let device = match device.notice {
        Some(notice) => format!("{}, then cpu: {notice}", device.name),
        None => device.name,
    };
    let hex = |hash: u64| format!("{hash:016x}");
    let named = [
        ("trex", env!("CARGO_PKG_VERSION").to_owned()),
        ("file", hex(model.file().superblock().file_id)),
        ("device", one_line(&device).into_owned()),
    ];
    let settings_facts = settings.values().map(|(key, value)| (key.name, value.to_string()));
    let hashed = [
        ("lamps", format!("{} in the scene, hash {}", view.lights.len(), hex(digest(&view.lights)))),
        ("materials", format!("hash {}", hex(digest(&session.model().materials)))),
        ("parts", format!("hash {}", hex(digest(&view.parts)))),
    ];
    let facts = named.into_iter().chain(settings_facts).chain(hashed);
    PartHead {
        resolution: settings.resolution,
        portion,
        spp: settings.spp,
        layers: session.film().layers(),
        exposure: settings.exposure.factor(),
        damaged_page_count: model.damage().len() as u32,
        camera: view.camera.numbers(),
        facts: facts.map(|(name, value)| (name.to_owned(), value)).collect(),
    }
}

impl PictureParts {
    /// Reads and checks the heads of part files, in any order.
    ///
    /// # Errors
    /// [`Code::InputMismatch`] for parts of different pictures, and where some are missing or there twice;
    /// [`Code::Usage`] for none, and for more than 4096; those of [`PartHead::read`] and of opening the files.
    pub fn open(paths: &[PathBuf]) -> Result<PictureParts> {
        if !(1..=PARTS_MAX).contains(&paths.len()) {
            return Err(Error::new(Code::Usage, "a picture is not merged from so many parts")
                .at_place("the parts")
                .numbers(format!("{} named, 1 to {PARTS_MAX} are accepted", paths.len()))
                .next("render fewer and larger parts"));
        }
        let (head, hash) = read_head(&paths[0])?;
        let lens = Camera::from_numbers(head.camera).project(head.resolution)?;
        let mut all = PictureParts {
            parts: vec![(paths[0].clone(), head.portion, hash)],
            lens,
            damaged_page_count: head.damaged_page_count,
            head,
        };
        for path in &paths[1..] {
            let (head, hash) = read_head(path)?;
            if let Some(difference) = all.head.difference(&head) {
                return Err(differs(&difference, path, &paths[0]));
            }
            all.damaged_page_count = all.damaged_page_count.max(head.damaged_page_count);
            all.parts.push((path.clone(), head.portion, hash));
        }
        let portions: Vec<Portion> = all.parts.iter().map(|(_, portion, _)| *portion).collect();
        match misfit(&portions, &Portion::whole(all.head.resolution, all.head.spp)) {
            Some(misfit) => Err(all.misfits(&misfit)),
            None => Ok(all),
        }
    }

    /// The head of the part that was named first: what it says of the picture holds for all.
    pub fn head(&self) -> &PartHead {
        &self.head
    }

    /// Count of the parts.
    pub fn part_count(&self) -> usize {
        self.parts.len()
    }

    /// Most damaged pages that one of the parts was made without.
    pub fn damaged_page_count(&self) -> u32 {
        self.damaged_page_count
    }

    /// Bytes that [`PictureParts::strips`] lease, encoder included.
    pub fn merge_bytes(&self) -> u64 {
        merge_bytes(self.head.resolution, self.head.layers, self.parts.len())
    }

    /// The picture, merged while it is written; filtered on the threads of `pool`.
    ///
    /// # Errors
    /// [`Code::MemoryLimit`] when `budget` has no room for [`PictureParts::merge_bytes`].
    pub fn strips<'a>(
        &'a self,
        pool: &'a ThreadPool,
        interrupt: &'a Interrupt,
        budget: &Budget,
    ) -> Result<MergedFiles<'a>> {
        let part = |(path, portion, hash): &(PathBuf, Portion, u64)| PartFile::new(path, (*portion, *hash));
        let setup = MergeSetup {
            head: &self.head,
            parts: self.parts.iter().map(part).collect(),
            open: open_part,
            lens: &self.lens,
            pool,
            interrupt,
        };
        MergedStrips::new(setup, budget)
    }

    /// The error of parts that make no picture.
    fn misfits(&self, misfit: &Misfit) -> Error {
        let named = |portion: &Portion| {
            let Portion { tiles: [first, end], samples: [from, to] } = portion;
            let (tiles, spp) = (tile_count(self.head.resolution), self.head.spp);
            format!("tiles {first}..{end} of {tiles}, samples {from}..{to} of {spp}")
        };
        let path = |index: usize| &self.parts[index].0;
        match misfit {
            Misfit::Missing(portion) => Error::new(Code::InputMismatch, "a part of the picture is missing")
                .at_place(named(portion))
                .numbers(format!("{} parts given, none has these", self.parts.len()))
                .next("render this part, and name it with the others"),
            Misfit::Doubled(portion, [one, two]) => {
                Error::new(Code::InputMismatch, "a part of the picture is there twice")
                    .at(path(*two))
                    .numbers(format!("{}: also in {}", named(portion), path(*one).display()))
                    .next("leave one of the two away")
            }
        }
    }
}

/// The head of a part file, with its hash.
///
/// # Errors
/// Those of [`PartHead::read`] and of opening the file.
pub fn read_head(path: &Path) -> Result<(PartHead, u64)> {
    let (mut reader, file_bytes) = open_part(path)?;
    PartHead::read(path, &mut reader, file_bytes)
}

fn open_part(path: &Path) -> Result<(BufReader<File>, u64)> {
    let file = open_regular(path)?;
    let about = file.metadata().map_err(|error| Error::io("open the part", path, &error))?;
    Ok((BufReader::new(file), about.len()))
}

fn differs(difference: &PartDifference, path: &Path, first: &Path) -> Error {
    let PartDifference { name, values: [ours, theirs] } = difference;
    Error::new(Code::InputMismatch, format!("these parts are of different pictures: another {name}"))
        .at(path)
        .numbers(format!("{name} {theirs} here, {ours} in {}", first.display()))
        .next("render all parts from the same file with the same settings, device and version")
}
