//! The table of marching cubes: which triangles each of the 256 sign patterns of a cell makes.
//!
//! It is made from a rule instead of being copied: on each face of a cell, segments run with the inside on their left
//! as seen from outside; on an ambiguous face each inside corner is cut off by a segment of its own. Linked segments
//! are loops, loops are cut into triangles.
//!
//! Invariants: 1. a face is cut the same way from both of its cells, since the rule sees nothing but the face:
//! no holes; 2. no diagonal of a loop lies in a face, so an edge belongs to two triangles at most;
//! 3. triangles are counter-clockwise seen from outside.
//!
//! Lorensen and Cline, "Marching Cubes", SIGGRAPH 1987; the rule for faces is Montani, Scateni, Scopigno 1994.

/// No pattern makes more triangles.
pub const MAX_TRIANGLES: usize = 6;

/// An edge of a cell. Corner `c` of a cell stands at `(c & 1, c >> 1 & 1, c >> 2)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CellEdge {
    /// The axis that it runs along.
    pub axis: usize,
    /// The corner that it begins at.
    pub corner: usize,
}

impl CellEdge {
    /// The edge between two neighbouring corners.
    fn between(a: usize, b: usize) -> CellEdge {
        CellEdge { axis: (a ^ b).trailing_zeros() as usize, corner: a & b }
    }
}

/// The triangles of a cell, by the edges that their corners lie on. Bit `c` of `pattern` says that corner `c` is
/// inside.
///
/// # Panics
/// When `pattern` has more than eight bits.
pub fn triangles(pattern: usize) -> Vec<[CellEdge; 3]> {
    assert!(pattern < 256, "a cell has eight corners");
    let mut triangles = Vec::new();
    for ring in rings(pattern) {
        let apex = fan_apex(&ring);
        let corner = |step: usize| ring[(apex + step) % ring.len()];
        triangles.extend((1..ring.len() - 1).map(|i| [0, i, i + 1].map(corner)));
    }
    triangles
}

/// The six faces, corners counter-clockwise seen from outside of the cell.
const FACES: [[usize; 4]; 6] =
    [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];

/// The loops of edges that the surface makes in a cell with the given sign pattern.
fn rings(pattern: usize) -> Vec<Vec<CellEdge>> {
    let inside = |corner: usize| pattern >> corner & 1 == 1;
    let mut next: Vec<(CellEdge, CellEdge)> = Vec::new();
    for face in FACES {
        // A run of inside corners (one alone on an ambiguous face) is cut off by one segment.
        for i in 0..4 {
            if inside(face[i]) && !inside(face[(i + 3) % 4]) {
                let run = (0..4).take_while(|&step| inside(face[(i + step) % 4])).count();
                let last = i + run - 1;
                let entry = CellEdge::between(face[(i + 3) % 4], face[i]);
                let exit = CellEdge::between(face[last % 4], face[(last + 1) % 4]);
                next.push((entry, exit));
            }
        }
    }
    let mut rings = Vec::new();
    while let Some((start, mut at)) = next.pop() {
        let mut ring = vec![start];
        while at != start {
            ring.push(at);
            let found = next.iter().position(|&(from, _)| from == at).expect("segments close to loops");
            at = next.swap_remove(found).1;
        }
        rings.push(ring);
    }
    rings
}

/// The place in `ring` from which a fan has the fewest diagonals within a face.
fn fan_apex(ring: &[CellEdge]) -> usize {
    (0..ring.len()).min_by_key(|&apex| face_diagonals(ring, apex)).unwrap_or(0)
}

/// Count of the fan's diagonals whose two ends lie on one face.
fn face_diagonals(ring: &[CellEdge], apex: usize) -> usize {
    let ends = |edge: CellEdge| [edge.corner, edge.corner | 1 << edge.axis];
    (2..ring.len() - 1)
        .filter(|step| {
            let [a, b] = [ends(ring[apex]), ends(ring[(apex + step) % ring.len()])];
            FACES.iter().any(|face| a.iter().chain(&b).all(|corner| face.contains(corner)))
        })
        .count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_pattern_has_a_diagonal_within_a_face_or_too_many_triangles() {
        for pattern in 0..256 {
            assert!(triangles(pattern).len() <= MAX_TRIANGLES, "{pattern}");
            for ring in rings(pattern) {
                assert_eq!(face_diagonals(&ring, fan_apex(&ring)), 0, "pattern {pattern}: {ring:?}");
            }
        }
        assert_eq!([0, 255, 1].map(|pattern| triangles(pattern).len()), [0, 0, 1]);
    }
}
