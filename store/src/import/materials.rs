//! `MaterialTable`: the materials of an OBJ file by name, filled from its MTL files.
//!
//! `tobj` reads the MTL text, of which it is given only the lines that a material here is made of: it panics on
//! colours of fewer than three numbers and refuses a whole file for one empty texture name.
//!
//! Invariants: 1. entry 0 is the default material; 2. an entry keeps its index for good, a name that is used before
//! it is defined is filled in later; 3. the first definition of a name wins, as the OBJ specification says of its
//! list of libraries; 4. nothing in an MTL file is an error: what cannot be used is a warning.

use super::ImportOptions;
use crate::budget::Lease;
use crate::error::{Code, Error, Result};
use crate::material::Material;
use crate::source::stamp;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::fs::File;
use std::io::Read;
use std::os::unix::ffi::OsStringExt;
use std::path::{Path, PathBuf};

/// Most bytes of an MTL file: 10,000 materials take about 2 MB.
const MAX_MTL_BYTES: u64 = 16 << 20;

/// Most materials, so that hostile files cannot fill the memory with names; CAD models have some thousands.
const MAX_MATERIALS: usize = 1 << 16;

/// Most `mtllib` names that are followed.
const MAX_LIBRARIES: usize = 1024;

/// Bytes charged per material beside its name, which is kept twice: the entry, the map, their slack.
const MATERIAL_BYTES: u64 = 512;

/// Keys that make a material, and the count of numbers that each is given to `tobj` with.
const KEYS: [(&str, usize); 7] =
    [("Kd", 3), ("Ks", 3), ("Ke", 3), ("Ns", 1), ("d", 1), ("Tr", 1), ("illum", 1)];

/// Materials by index and by name.
pub(super) struct MaterialTable {
    entries: Vec<Material>,
    index_of_name: HashMap<String, u32>,
    /// Names used by faces and not defined so far.
    undefined: HashSet<u32>,
    /// Each with its stamp before it was read.
    libraries: BTreeMap<PathBuf, String>,
    transparent_count: u64,
    lease: Lease,
}

impl MaterialTable {
    /// A table with the default material.
    pub(super) fn new(options: &ImportOptions) -> Result<MaterialTable> {
        Ok(MaterialTable {
            entries: vec![Material::default()],
            index_of_name: HashMap::new(),
            undefined: HashSet::new(),
            libraries: BTreeMap::new(),
            transparent_count: 0,
            lease: options.budget.lease("materials", MATERIAL_BYTES)?,
        })
    }

    /// All materials so far.
    pub(super) fn entries(&self) -> &[Material] {
        &self.entries
    }

    /// MTL files that were looked for, by full path, each with its stamp.
    pub(super) fn libraries(&self) -> Vec<(Vec<u8>, String)> {
        let full = |path: &PathBuf| std::path::absolute(path).unwrap_or_else(|_| path.clone());
        let libraries = self.libraries.iter();
        libraries.map(|(path, stamp)| (full(path).into_os_string().into_vec(), stamp.clone())).collect()
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
        if let Some(&index) = self.index_of_name.get(name) {
            return Ok(index);
        }
        let index = self.append(Material { name: name.to_owned(), ..Material::default() })?;
        self.undefined.insert(index);
        Ok(index)
    }

    /// Names that faces use and no library defines, as a warning for the end of the stream.
    pub(super) fn undefined_warning(&self) -> Option<String> {
        let first = self.undefined.iter().min()?;
        let (name, count) = (&self.entries[*first as usize].name, self.undefined.len());
        Some(format!(
            "{count} material names are not defined in any MTL file and are drawn grey; one is `{name}`"
        ))
    }

    /// Follows `mtllib names` of an OBJ file in `folder`; each library once. Returns what to warn of.
    pub(super) fn load_libraries(
        &mut self,
        folder: &Path,
        names: &str,
        options: &ImportOptions,
    ) -> Result<Vec<String>> {
        let mut warnings = Vec::new();
        for path in library_paths(folder, names) {
            if self.libraries.len() >= MAX_LIBRARIES {
                warnings.push(format!("more than {MAX_LIBRARIES} MTL files: the rest is not read"));
                break;
            }
            if !self.libraries.contains_key(&path) {
                self.libraries.insert(path.clone(), stamp(&path));
                warnings.extend(self.load_library(&path, options)?);
            }
        }
        Ok(warnings)
    }

    fn load_library(&mut self, path: &Path, options: &ImportOptions) -> Result<Option<String>> {
        let shown = path.display();
        let bytes = match std::fs::metadata(path) {
            Err(error) => {
                return Ok(Some(format!(
                    "MTL file {shown} cannot be read ({error}): its materials are grey"
                )));
            }
            Ok(kind) if !kind.is_file() => {
                return Ok(Some(format!("MTL file {shown} is not a regular file")));
            }
            Ok(kind) if kind.len() > MAX_MTL_BYTES => {
                return Ok(Some(format!("MTL file {shown} has more than {MAX_MTL_BYTES} bytes: not read")));
            }
            Ok(kind) => kind.len(),
        };
        // The text, its cleaned copy, and the strings and maps that tobj makes of it.
        let _lease = options.budget.lease("an MTL file", 8 * bytes)?;
        let mut text = Vec::new();
        if let Err(error) = File::open(path).and_then(|file| file.take(bytes).read_to_end(&mut text)) {
            return Ok(Some(format!("MTL file {shown} cannot be read ({error}): its materials are grey")));
        }
        let (cleaned, dropped) = clean(&String::from_utf8_lossy(&text));
        match tobj::load_mtl_buf(&mut cleaned.as_bytes()) {
            Err(error) => return Ok(Some(format!("MTL file {shown} is not understood ({error})"))),
            Ok((materials, _)) => {
                for material in materials {
                    self.define(from_tobj(material))?;
                }
            }
        }
        Ok((dropped > 0)
            .then(|| format!("MTL file {shown}: {dropped} lines without proper numbers are not used")))
    }

    fn define(&mut self, material: Material) -> Result<()> {
        let transparent = u64::from(material.d < 1.0);
        match self.index_of_name.get(&material.name) {
            None => {
                self.append(material)?;
            }
            Some(index) if self.undefined.remove(index) => self.entries[*index as usize] = material,
            Some(_) => return Ok(()),
        }
        self.transparent_count += transparent;
        Ok(())
    }

    fn append(&mut self, material: Material) -> Result<u32> {
        if self.entries.len() >= MAX_MATERIALS {
            return Err(Error::new(Code::InputRange, "the input names too many materials")
                .at_place(format!("usemtl or newmtl {}", material.name))
                .numbers(format!("more than {MAX_MATERIALS}"))
                .next("export the mesh with fewer materials"));
        }
        self.lease.grow("materials", MATERIAL_BYTES + 2 * material.name.len() as u64)?;
        let index = self.entries.len() as u32;
        self.index_of_name.insert(material.name.clone(), index);
        self.entries.push(material);
        Ok(index)
    }
}

/// The files that a `mtllib` row names: the whole row if there is such a file (names with spaces), else its words.
fn library_paths(folder: &Path, names: &str) -> Vec<PathBuf> {
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

/// The lines of an MTL text that make a material, in the form that `tobj` takes, and how many had to be left out.
fn clean(text: &str) -> (String, u64) {
    let (mut cleaned, mut dropped) = (String::new(), 0);
    for line in text.lines().map(|line| line.trim_start_matches('\u{feff}').trim()) {
        let mut words = line.split_whitespace();
        let key = words.next().unwrap_or_default();
        if key == "newmtl" {
            let name = line[key.len()..].trim();
            dropped += u64::from(name.is_empty());
            // Without a name, lines that follow must not change the material before.
            cleaned += &format!("newmtl {}\n", if name.is_empty() { "(no name)" } else { name });
        } else if let Some((_, count)) = KEYS.iter().find(|(known, _)| *known == key) {
            match numbers(words, *count, key) {
                Some(numbers) => cleaned += &format!("{key} {numbers}\n"),
                None => dropped += 1,
            }
        }
    }
    (cleaned, dropped)
}

/// `count` numbers; green and blue that are left out equal red, as the MTL specification says.
fn numbers<'a>(words: impl Iterator<Item = &'a str>, count: usize, key: &str) -> Option<String> {
    let mut numbers: Vec<&str> = words.filter(|&word| word != "-halo").take(count).collect();
    let well_formed =
        |word: &&str| if key == "illum" { word.parse::<u8>().is_ok() } else { word.parse::<f32>().is_ok() };
    if numbers.is_empty() || !numbers.iter().all(well_formed) {
        return None;
    }
    numbers.resize(count, numbers[0]);
    Some(numbers.join(" "))
}

fn from_tobj(material: tobj::Material) -> Material {
    let default = Material::default();
    let transparency = || material.unknown_param.get("Tr").and_then(|text| text.parse::<f32>().ok());
    Material {
        d: material.dissolve.or_else(|| transparency().map(|tr| 1.0 - tr)).unwrap_or(default.d),
        name: material.name,
        kd: material.diffuse.unwrap_or(default.kd),
        ks: material.specular.unwrap_or(default.ks),
        ns: material.shininess.unwrap_or(default.ns),
        ke: material.emissive.unwrap_or(default.ke),
        mirror: matches!(material.illumination_model, Some(3 | 5)),
    }
    .checked()
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
        let warnings = table.load_libraries(folder.path(), "a b.mtl", &options).unwrap();
        (table, warnings)
    }

    #[test]
    fn what_a_material_takes_from_its_text() {
        let (table, warnings) = load(
            b"newmtl  Hard Plastic \nKd 0.5\nKs 0.25 0.5 0.125\nNs 20\nillum 3\nd 0.5\nmap_Kd\n\
              newmtl lamp\nKe 4 5 6\nKd spectral x.rfl\nKs 0 0 0\nillum 5\nTr 0.25\n\
              newmtl lamp\nKe 1 1 1\nnewmtl solid\r\nd 1\r\nTr 1\r\n",
        );
        let [default, plastic, lamp, solid] = table.entries() else { panic!("{:?}", table.entries()) };
        assert_eq!(*default, Material::default());
        assert_eq!(
            (plastic.name.as_str(), plastic.kd, plastic.ks),
            ("Hard Plastic", [0.5; 3], [0.25, 0.5, 0.125])
        );
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
        assert_eq!(table.load_libraries(folder.path(), "none.mtl .\\m.mtl", &options).unwrap().len(), 1);
        assert_eq!((table.entries()[1].kd, table.undefined_warning()), ([0.5; 3], None));
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
            for material in table.entries() {
                let colours = material.kd.iter().chain(&material.ks).chain(&material.ke);
                let numbers = colours.chain([&material.ns, &material.d]);
                prop_assert!(numbers.clone().all(|value| value.is_finite() && *value >= 0.0));
            }
        }
    }
}
