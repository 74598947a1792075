//! `MaterialTable`: the materials of an OBJ file by name, filled from its MTL files.
//!
//! MTL text is read line by line ([`mtl`](super::mtl)), so that memory is taken for materials alone.
//!
//! Invariants: 1. entry 0 is what has no material, and grey unless a library defines one called `default`; 2. an
//! entry keeps its index for good, a name that is used before it is defined is filled in later; 3. the first
//! definition of a name wins, as the OBJ specification says of its list of libraries; 4. nothing in an MTL file is an
//! error: what cannot be used is a warning; 5. names are looked up as files hold them, so that a long one is found by
//! what it was cut to.

use super::material_pictures::MaterialPictures;
use super::mtl;
use super::{ImportOptions, MaterialNaming};
use crate::budget::{Budget, Lease};
use crate::error::{Code, Error, Result};
use crate::layout::MATERIALS;
use crate::material::Material;
use crate::material_list::{DEFAULT_NAME, MaterialList};
use crate::material_names::stored_name;
use crate::stamp;
use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::fs::File;
use std::io;
use std::os::unix::ffi::OsStringExt;
use std::path::{Path, PathBuf};
use xxhash_rust::xxh3::xxh3_64;

/// Most bytes of an MTL file: what 65,536 materials with the longest names take, twice over.
const MAX_MTL_BYTES: u64 = 64 << 20;

/// Most `mtllib` names that are followed.
pub(super) const MAX_LIBRARIES: usize = 1024;

/// Bytes charged per material beside its name, which is kept twice: the entry, the map, and both again while they grow.
const MATERIAL_BYTES: u64 = 320;

/// Bytes of the row of a picture, beside the name of its file.
const PICTURE_ROW_BYTES: u64 = 2 * (size_of::<mtl::PictureRow>() as u64 + 8);

/// Bytes that a table leases for `count` materials, whose names have so many bytes together.
pub(in crate::import) fn table_bytes(count: u64, name_bytes: u64) -> u64 {
    count * MATERIAL_BYTES + 2 * name_bytes
}

/// Materials by index and by name.
pub(super) struct MaterialTable {
    entries: MaterialList,
    index_of_name: HashMap<Box<str>, u32>,
    /// Names used by faces and not defined so far, and the default's.
    undefined: HashSet<u32>,
    /// Each with its stamp before it was read.
    libraries: BTreeMap<PathBuf, String>,
    pictures: MaterialPictures,
    transparent_count: u64,
    /// Bytes of all names, as files hold them.
    name_bytes: u64,
    naming: MaterialNaming,
    budget: Budget,
    lease: Lease,
}

impl MaterialTable {
    /// A table with the default material.
    pub(super) fn new(options: &ImportOptions) -> Result<MaterialTable> {
        Ok(MaterialTable {
            entries: MaterialList::from(Material::default()),
            index_of_name: HashMap::from([(key(options.naming, DEFAULT_NAME).into(), 0)]),
            undefined: HashSet::from([0]),
            libraries: BTreeMap::new(),
            pictures: MaterialPictures::new(options)?,
            transparent_count: 0,
            name_bytes: DEFAULT_NAME.len() as u64,
            naming: options.naming,
            budget: options.budget.clone(),
            lease: options.budget.lease("materials", table_bytes(1, 0))?,
        })
    }

    /// All materials so far.
    pub(super) fn entries(&self) -> &MaterialList {
        &self.entries
    }

    /// Their pictures.
    pub(super) fn pictures(&self) -> &MaterialPictures {
        &self.pictures
    }

    /// Their pictures, to look into.
    pub(super) fn pictures_mut(&mut self) -> &mut MaterialPictures {
        &mut self.pictures
    }

    /// MTL files and pictures that were looked for, by full path, each with its stamp.
    pub(super) fn named_files(&self) -> Vec<(Vec<u8>, String)> {
        let full = |path: &PathBuf| std::path::absolute(path).unwrap_or_else(|_| path.clone());
        let files = self.libraries.iter().chain(self.pictures.files());
        files.map(|(path, stamp)| (full(path).into_os_string().into_vec(), stamp.clone())).collect()
    }

    /// Bytes of all names, as files hold them.
    pub(super) fn name_bytes(&self) -> u64 {
        self.name_bytes
    }

    /// Materials with `d` < 1.
    pub(super) fn transparent_count(&self) -> u64 {
        self.transparent_count
    }

    /// The index for `usemtl name`; a name never seen gets the default material under that name.
    pub(super) fn index_of(&mut self, name: &str) -> Result<u32> {
        if name.is_empty() {
            return Ok(0);
        }
        let name = &*stored_name(name);
        if let Some(&index) = self.index_of_name.get(&*key(self.naming, name)) {
            return Ok(index);
        }
        let index = self.append(name, Material::default())?;
        self.undefined.insert(index);
        Ok(index)
    }

    /// Names that faces use and no library defines, as a warning for the end of the stream.
    pub(super) fn undefined_warning(&self) -> Option<String> {
        let named = || self.undefined.iter().filter(|index| **index != 0);
        let (name, count) = (self.entries.name(*named().min()? as usize), named().count());
        Some(format!(
            "{count} material names are not defined in any MTL file and are drawn grey; one is `{name}`"
        ))
    }

    /// Follows `mtllib names` of an OBJ file in `folder`; each library once. Returns what to warn of.
    pub(super) fn load_libraries(&mut self, folder: &Path, names: &str) -> Result<Vec<String>> {
        let mut warnings = Vec::new();
        for path in library_paths(folder, names) {
            if self.libraries.len() >= MAX_LIBRARIES {
                warnings.push(format!("more than {MAX_LIBRARIES} MTL files: the rest is not read"));
                break;
            }
            if !self.libraries.contains_key(&path) {
                self.libraries.insert(path.clone(), stamp(&path));
                self.load_library(&path, &mut warnings)?;
            }
        }
        Ok(warnings)
    }

    fn load_library(&mut self, path: &Path, warnings: &mut Vec<String>) -> Result<()> {
        let shown = path.display();
        let unread =
            |error: io::Error| format!("MTL file {shown} cannot be read ({error}): its materials are grey");
        let bytes = match std::fs::metadata(path) {
            Err(error) => Err(unread(error)),
            Ok(kind) if !kind.is_file() => Err(format!("MTL file {shown} is not a regular file")),
            Ok(kind) if kind.len() > MAX_MTL_BYTES => {
                Err(format!("MTL file {shown} has more than {MAX_MTL_BYTES} bytes: not read"))
            }
            Ok(kind) => Ok(kind.len()),
        };
        let bytes = match bytes {
            Ok(bytes) => bytes,
            Err(why) => {
                warnings.push(why);
                return Ok(());
            }
        };
        let lease = self.budget.lease("an MTL file", mtl::READING_BYTES)?;
        let (mut refused, mut with_pictures) = (None, Vec::new());
        let read = File::open(path).and_then(|file| {
            mtl::read(file, bytes, &mut |name, material, picture| {
                let defined = self.define(name, material);
                if let (Ok(Some(index)), Some(row)) = (&defined, picture) {
                    let grown = self.lease.grow("materials", PICTURE_ROW_BYTES + row.file.len() as u64);
                    refused = grown.err();
                    with_pictures.push((*index, row));
                }
                refused = refused.take().or(defined.err());
                refused.is_none()
            })
        });
        drop(lease);
        match (refused, read) {
            (Some(error), _) => return Err(error),
            (None, Err(error)) => warnings.push(unread(error)),
            (None, Ok(dropped)) if dropped > 0 => warnings.push(format!(
                "MTL file {shown}: {dropped} lines without proper numbers or names are not used"
            )),
            (None, Ok(_)) => {}
        }
        let folder = path.parent().unwrap_or(Path::new(""));
        for (index, row) in with_pictures {
            let material = self.entries[index as usize];
            let (material, told) = self.pictures.read((index, material), &row, folder)?;
            self.entries.replace(index as usize, material);
            warnings.extend(told);
        }
        Ok(())
    }

    /// Gives the index of a material that was not defined before.
    fn define(&mut self, name: &str, material: Material) -> Result<Option<u32>> {
        let index = match self.index_of_name.get(&*key(self.naming, name)) {
            None => self.append(name, material)?,
            Some(index) if self.undefined.remove(index) => {
                self.entries.replace(*index as usize, material);
                *index
            }
            Some(_) => return Ok(None),
        };
        self.transparent_count += u64::from(material.d < 1.0);
        Ok(Some(index))
    }

    fn append(&mut self, name: &str, material: Material) -> Result<u32> {
        if self.entries.len() >= MATERIALS {
            return Err(Error::new(Code::InputRange, "the input names too many materials")
                .at_place(format!("usemtl or newmtl {name}"))
                .numbers(format!("more than {MATERIALS}"))
                .next("export the mesh with fewer materials"));
        }
        self.lease.grow("materials", table_bytes(1, name.len() as u64))?;
        let (index, key) = (self.entries.len() as u32, key(self.naming, name));
        self.name_bytes += name.len() as u64;
        self.entries.push(&key, material);
        self.index_of_name.insert(key.into(), index);
        Ok(index)
    }
}

/// What is kept of a name.
pub(in crate::import) fn key(naming: MaterialNaming, name: &str) -> Cow<'_, str> {
    match naming {
        MaterialNaming::Names => Cow::Borrowed(name),
        MaterialNaming::Hashes => Cow::Owned(format!("{:016x}", xxh3_64(name.as_bytes()))),
    }
}

/// The files that a `mtllib` row names: the whole row if there is such a file (names with spaces), else its words.
pub(super) fn library_paths(folder: &Path, names: &str) -> Vec<PathBuf> {
    let resolve = |name: &str| {
        let path = folder.join(name);
        // Exporters on Windows write their own separators.
        if path.is_file() || !name.contains('\\') { path } else { folder.join(name.replace('\\', "/")) }
    };
    let whole = resolve(names.trim_matches('"'));
    if whole.is_file() {
        vec![whole]
    } else {
        names.split_whitespace().take(MAX_LIBRARIES).map(resolve).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Loads one MTL text and gives the table and its warnings.
    fn load(text: &[u8]) -> (MaterialTable, Vec<String>) {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a b.mtl"), text).unwrap();
        let options = ImportOptions::unlimited(folder.path());
        let mut table = MaterialTable::new(&options).unwrap();
        let warnings = table.load_libraries(folder.path(), "a b.mtl").unwrap();
        (table, warnings)
    }

    #[test]
    fn what_a_material_takes_from_its_text() {
        let (table, warnings) = load(
            b"newmtl  Hard Plastic \nKd 0.5\nKs 0.25 0.5 0.125\nNs 20\nillum 3\nd 0.5\nmap_Kd\n\
              newmtl lamp\nKe 4 5 6\nKd spectral x.rfl\nKs 0 0 0\nillum 5\nTr 0.25\n\
              newmtl lamp\nKe 1 1 1\nnewmtl solid\r\nd 1\r\nTr 1\r\n",
        );
        let [default, plastic, lamp, solid] = **table.entries() else { panic!("{:?}", table.entries()) };
        assert_eq!(default, Material::default());
        let names = ["default", "Hard Plastic", "lamp", "solid"];
        assert_eq!(table.entries().names().iter().collect::<Vec<_>>(), names);
        assert_eq!((plastic.kd, plastic.ks), ([0.5; 3], [0.25, 0.5, 0.125]));
        assert_eq!((plastic.ns, plastic.d, plastic.mirror), (20.0, 0.5, true));
        assert_eq!((lamp.ke, lamp.mirror, lamp.d), ([4.0, 5.0, 6.0], false, 0.75));
        assert_eq!(solid.d, 1.0);
        assert_eq!(table.transparent_count(), 2);
        assert_eq!(warnings.len(), 1, "{warnings:?}");
    }

    #[test]
    fn a_name_used_before_it_is_defined_is_filled_in() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("m.mtl"), "newmtl a\nKd 0.5 0.5 0.5\n").unwrap();
        let options = ImportOptions::unlimited(folder.path());
        let mut table = MaterialTable::new(&options).unwrap();
        assert_eq!((table.index_of("").unwrap(), table.index_of("a").unwrap()), (0, 1));
        assert!(table.undefined_warning().is_some());
        assert_eq!(table.load_libraries(folder.path(), "none.mtl .\\m.mtl").unwrap().len(), 1);
        assert_eq!((table.entries()[1].kd, table.undefined_warning()), ([0.5; 3], None));
    }

    /// Names of a thousand bytes each were kept as they were, three times, and read whole with their file.
    #[test]
    fn long_names_are_cut_and_found_again() {
        let long = |end: &str| format!("{}{end}", "\u{e4}".repeat(700));
        let text = format!("newmtl {}\nKd 1 0 0\nnewmtl {}\nKd 0 1 0\n", long("one"), long("two"));
        let (mut table, warnings) = load(text.as_bytes());
        assert_eq!((warnings.len(), table.entries().len()), (0, 3));
        assert_eq!((table.index_of(&long("two")).unwrap(), table.index_of(&long("one")).unwrap()), (2, 1));
        assert_eq!((table.entries()[1].kd, table.entries()[2].kd), ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]));
        assert!(table.entries().names().iter().all(|name| name.len() <= 255));
        assert_eq!(table.undefined_warning(), None);
    }

    proptest! {
        #[test]
        fn any_text_gives_sound_materials(lines in proptest::collection::vec(
            ("(newmtl|Kd|Ks|Ke|Ns|d|Tr|illum|map_Kd|bump|#)", "[ -~]{0,12}"), 0..12), tail: Vec<u8>)
        {
            let line = |(key, rest): &(_, _)| format!("{key} {rest}\n").into_bytes();
            let mut text: Vec<u8> = lines.iter().flat_map(line).collect();
            text.extend(tail);
            let (table, _) = load(&text);
            for material in table.entries().iter() {
                let colours = material.kd.iter().chain(&material.ks).chain(&material.ke);
                let numbers = colours.chain([&material.ns, &material.d]);
                prop_assert!(numbers.clone().all(|value| value.is_finite() && *value >= 0.0));
            }
        }
    }
}
