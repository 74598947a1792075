//! Bytes that no exporter wrote: files cut at every byte, changed at random, and made of noise. Readers may refuse
//! them or not, but they end, do not panic, and deliver no more than was declared.

use super::{Fixture, read};
use crate::budget::{Budget, RESERVE_BYTES};
use crate::error::{Code, Result};
use proptest::prelude::*;

/// Small valid files, and the triangles that each holds.
fn seeds() -> Vec<(&'static str, Vec<u8>, usize)> {
    let obj = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nusemtl m\nf 1/2/3 2 3 4\nf -1 -2 \\\n -3\n";
    let ply = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
             element face 2\nproperty list uchar int vertex_indices\nelement tristrips 1\n\
             property list int int vertex_indices\nend_header\n"
        )
    };
    let ascii = ply("ascii") + "0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n4 0 1 2 3\n5 0 1 2 -1 3\n";
    let bytes = |four: fn(u32) -> [u8; 4]| {
        let mut bytes: Vec<u8> =
            [0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0].iter().flat_map(|&v| four((v as f32).to_bits())).collect();
        for face in [&[0u32, 1, 2][..], &[0, 1, 2, 3]] {
            bytes.push(face.len() as u8);
            bytes.extend(face.iter().flat_map(|&index| four(index)));
        }
        bytes.extend([5u32, 0, 1, 2, u32::MAX, 3].iter().flat_map(|&item| four(item)));
        bytes
    };
    let little = [ply("binary_little_endian").as_bytes(), &bytes(u32::to_le_bytes)].concat();
    let big = [ply("binary_big_endian").as_bytes(), &bytes(u32::to_be_bytes)].concat();
    let text = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n\
                endsolid a\n";
    let mut records = vec![b'x'; 80];
    records.extend(2u32.to_le_bytes());
    records.extend([1; 100]);
    vec![
        ("a.obj", obj.into(), 3),
        ("a.ply", ascii.into(), 4),
        ("a.ply", little, 4),
        ("a.ply", big, 4),
        ("a.stl", text.into(), 1),
        ("a.stl", records, 2),
        ("a.glb", super::gltf::small_glb(), 2),
    ]
}

/// Reads under a small budget; the error, if any, must be about the input.
fn survive(name: &str, content: &[u8]) -> Result<usize> {
    let fixture = Fixture::new(name, content);
    let mut options = fixture.options();
    options.budget = Budget::new(RESERVE_BYTES + (3 << 20));
    let result = read(&fixture.path, &options).map(|mesh| mesh.triangles.len());
    if let Err(error) = &result {
        let about_input = matches!(
            error.code(),
            Code::InputFormat | Code::InputTruncated | Code::InputRange | Code::InputEmpty
        );
        assert!(about_input && !error.place().is_empty(), "{error}");
    }
    assert_eq!(options.budget.used_bytes(), 0);
    result
}

#[test]
fn cut_at_every_byte() {
    for (name, content, count) in seeds() {
        assert_eq!(survive(name, &content).unwrap(), count, "{name}");
        for length in 0..content.len() {
            if let Ok(found) = survive(name, &content[..length]) {
                assert!(found <= count, "{name} cut to {length}: {found} triangles");
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn changed_at_random(
        seed in 0usize..7,
        changes in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>(), 0u8..4), 1..8),
    ) {
        let (name, mut content, _) = seeds().swap_remove(seed);
        for (at, byte, kind) in changes {
            let at = at.index(content.len());
            match kind {
                0 => content[at] = byte,
                1 => content[at] ^= 1 << (byte % 8),
                2 => content.insert(at, byte),
                _ => {
                    let piece = content[at..].iter().copied().take(usize::from(byte % 32)).collect::<Vec<_>>();
                    content.splice(at..at, piece);
                }
            }
        }
        let _ = survive(name, &content);
    }

    #[test]
    fn noise(
        name in "a(\\.obj|\\.ply|\\.stl|\\.glb|\\.gltf)?",
        content in proptest::collection::vec(any::<u8>(), 0..300),
    ) {
        let _ = survive(&name, &content);
    }

    #[test]
    fn words_of_the_formats(name in "a(\\.obj|\\.ply|\\.stl)?", words in proptest::collection::vec(
        "(\n|\r\n|\\\\\n| |v |f |usemtl |mtllib |-?[0-9]{1,3} |[0-9]/[0-9] |1e[0-9]{1,3} |nan |ply\n|\
         format ascii 1.0\n|\
         format binary_little_endian 1.0\n|element (vertex|face|tristrips|x) [0-9]{1,3}\n|\
         property (float|uchar) [xyz]\n|\
         property list (uchar|int|char) (int|uchar|double) vertex_index\n|end_header\n|solid |facet |normal |\
         outer |loop |\
         vertex |endloop |endfacet |endsolid )", 0..60),
        ply in any::<bool>())
    {
        let head = if ply { "ply\nformat ascii 1.0\n" } else { "" };
        let _ = survive(&name, format!("{head}{}", words.concat()).as_bytes());
    }
}
