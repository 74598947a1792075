//! What records and keys are called on a page.

/// A name as people say it: `isosurface-20m` reads `iso-surface 20M`.
pub(super) fn label(name: &str) -> String {
    let word = |word: &str| match word {
        "isosurface" => "iso-surface".to_owned(),
        "pipes" => "plant".to_owned(),
        "kicad" => "CAD".to_owned(),
        "gi" => "GI".to_owned(),
        "lod" => "LOD".to_owned(),
        count if count.strip_suffix('m').is_some_and(|digits| digits.parse::<u32>().is_ok()) => {
            count.to_uppercase()
        }
        other => other.to_owned(),
    };
    let name = name.replace("kicad-grid", "kicad").replace("no-asvo", "without-voxels");
    name.split('-').filter(|part| !part.is_empty()).map(word).collect::<Vec<_>>().join(" ")
}

/// A key as a column's or an axis' title, the unit being in the cells: `memory.peak_rss_bytes` reads `memory
/// peak rss`, `triangle_count` reads `triangles`.
pub(super) fn title(key: &str) -> String {
    let bare = |part: &str| match part.strip_suffix("_count") {
        Some(counted) => format!("{counted}s"),
        None => part.strip_suffix("_bytes").or(part.strip_suffix("_ms")).unwrap_or(part).to_owned(),
    };
    let parts: Vec<String> = key.split('.').map(bare).collect();
    parts.join(" ").replace('_', " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_read_as_people_say_them() {
        for (name, expected) in [
            ("isosurface-20m", "iso-surface 20M"),
            ("kicad-grid-flip", "CAD flip"),
            ("isosurface-100m-no-asvo", "iso-surface 100M without voxels"),
            ("pipes-interior-full-gi", "plant interior full GI"),
            ("a", "a"),
            ("-", ""),
        ] {
            assert_eq!(label(name), expected);
        }
    }

    #[test]
    fn titles_leave_the_unit_to_the_cells() {
        assert_eq!(title("memory.peak_rss_bytes"), "memory peak rss");
        assert_eq!(title("triangle_count"), "triangles");
        assert_eq!(title("triangles_per_s"), "triangles per s");
        assert_eq!(title("bytes_per_triangle.disk"), "bytes per triangle disk");
    }
}
