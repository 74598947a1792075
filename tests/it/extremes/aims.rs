//! Rays on the lattice of a model: how they are aimed at it.

use super::TraceCase;
use crate::oracle::exact::{self, Q};
use crate::random::Random;

/// A ray on the lattice, and what is added to its direction (relative to it) that no integer can say.
#[derive(Clone, Copy, Debug)]
pub(super) struct Aim {
    pub(super) origin: Q,
    pub(super) direction: Q,
    pub(super) tiny: [f64; 3],
}

/// How a ray is aimed at a model.
#[derive(Clone, Copy)]
pub(super) enum Way {
    /// From in and around the box to anywhere in it.
    Anywhere,
    /// To a point of a triangle; every third one to a vertex, every third one to an edge.
    AtTriangles,
    /// Along an axis, through a vertex.
    AlongAxis,
    /// In the plane of a box through a vertex.
    InBoxPlane,
    /// In the plane of a triangle.
    InTriangle,
    /// Along an axis through a vertex, but for a component of 1e-30.
    Tiny,
}

pub(super) const WAYS: [Way; 6] =
    [Way::Anywhere, Way::AtTriangles, Way::AlongAxis, Way::InBoxPlane, Way::InTriangle, Way::Tiny];

pub(super) fn aim(model: &TraceCase, way: Way, i: usize, rng: &mut Random) -> Aim {
    let side: Q = exact::sub(model.hi, model.lo);
    let mut inside = || -> Q { std::array::from_fn(|a| model.lo[a] + rng.below(side[a] + 1)) };
    let (mut origin, mut target) = (inside(), inside());
    if i.is_multiple_of(2) {
        // Half of the way out of the box.
        origin = std::array::from_fn(|a| origin[a] + [-1, 1][i / 2 % 2] * side[a] / 2);
    }
    let [a, b, c] = model.triangles[rng.below(model.triangles.len() as i64) as usize];
    let axis = i % 3;
    let mut tiny = [0.0; 3];
    match way {
        Way::Anywhere => {}
        Way::AtTriangles => match i % 3 {
            0 => target = a,
            // Twice as far as the middle of the edge.
            1 => target = std::array::from_fn(|x| a[x] + b[x] - origin[x]),
            _ => {
                let weights = [rng.below(64), rng.below(64), 1 + rng.below(64)];
                let middle = |x: usize| {
                    let sum = weights
                        .iter()
                        .zip([a, b, c])
                        .map(|(w, q)| i128::from(*w) * i128::from(q[x]))
                        .sum::<i128>();
                    (sum / i128::from(weights.iter().sum::<i64>())) as i64
                };
                target = std::array::from_fn(middle);
            }
        },
        Way::AlongAxis | Way::Tiny => {
            target = a;
            target[axis] = origin[axis] + [1, -1][i / 3 % 2];
            origin = std::array::from_fn(|x| if x == axis { origin[x] } else { a[x] });
            if matches!(way, Way::Tiny) {
                tiny[(axis + 1 + i / 6 % 2) % 3] = [1e-30, -1e-30][i / 12 % 2];
            }
        }
        Way::InBoxPlane => (origin[axis], target[axis]) = (a[axis], a[axis]),
        Way::InTriangle => {
            origin = std::array::from_fn(|x| 2 * a[x] - b[x]);
            target = std::array::from_fn(|x| b[x] + c[x] - a[x]);
        }
    }
    Aim { origin, direction: exact::sub(target, origin), tiny }
}
