//! Counts, order, hints, materials, memory.

use super::{collect, open, open_seeded};
use datasets_gen::{GenOptions, Kind, Spec, views};
use trex_store::{Budget, Code, Interrupt, TriangleBatch};
use xxhash_rust::xxh3::Xxh3;

fn hash(batch: &TriangleBatch) -> u64 {
    let mut hasher = Xxh3::new();
    for (corners, material) in batch.corners.iter().zip(&batch.material) {
        for value in corners.as_flattened() {
            hasher.update(&value.to_le_bytes());
        }
        hasher.update(&material.to_le_bytes());
    }
    hasher.digest()
}

#[test]
fn counts_are_within_one_percent_of_asked_and_of_the_hint() {
    for kind in Kind::ALL {
        for (triangles, seed) in [
            (10_000, 1),
            (10_000, 77),
            (12_345, 2),
            (100_000, 1),
            (100_000, 3),
            (1_000_000, 1),
            (3_000_000, 2),
        ] {
            let mut source = open_seeded(Spec { kind, triangles, seed, colours: None }, 2);
            let hint = source.hint().unwrap().triangle_count;
            let (mut batch, mut count) = (TriangleBatch::default(), 0);
            while source.next_batch(&mut batch).unwrap() {
                count += batch.len() as u64;
            }
            for expected in [triangles, hint] {
                assert!(count.abs_diff(expected) * 100 <= expected, "{}: {count}", source.name());
            }
            assert_eq!(source.stats().triangle_count, count);
        }
    }
}

/// Page files are told apart by their input: a generator that is written anew must make the same bytes. Plants and
/// statues are not here, their sines come from the system.
#[test]
fn the_bytes_of_a_spec_do_not_change() {
    for (text, expected) in [
        ("gen:isosurface:10k:1", 0x5b13_1ee5_9f0b_5d29),
        ("gen:isosurface:300k:3", 0x95de_ec7d_0ad5_097c),
        ("gen:soup:10k:1", 0xf823_7af4_e17f_af23),
        ("gen:soup:12371:4", 0x16d8_465a_94eb_a9aa_u64),
    ] {
        let mut source = open_seeded(Spec::parse(text).unwrap(), 2);
        assert_eq!(hash(&collect(&mut *source)), expected, "{text}");
    }
}

#[test]
fn the_stream_is_the_same_at_any_thread_count_after_rewind_and_differs_by_seed() {
    for kind in Kind::ALL {
        let mut source = open(kind, 60_000, 1);
        let expected = hash(&collect(&mut *source));
        source.rewind().unwrap();
        assert_eq!(hash(&collect(&mut *source)), expected, "{kind:?} after rewind");
        for threads in [2, 5] {
            assert_eq!(hash(&collect(&mut *open(kind, 60_000, threads))), expected, "{kind:?} {threads}");
        }
        let mut other = open_seeded(Spec { kind, triangles: 60_000, seed: 2, colours: None }, 2);
        assert_ne!(hash(&collect(&mut *other)), expected, "{kind:?} with another seed");
    }
}

#[test]
fn hints_hold_and_positions_are_single_precision_but_in_the_soup() {
    for kind in Kind::ALL {
        for triangles in [10_000, 400_000] {
            let mut source = open(kind, triangles, 2);
            let all = collect(&mut *source);
            let hint = source.hint().unwrap();
            let mut edges = Vec::new();
            for corners in &all.corners {
                for (corner, next) in corners.iter().zip([corners[1], corners[2], corners[0]]) {
                    for (axis, &value) in corner.iter().enumerate() {
                        assert!(value >= hint.bounds.lo[axis] && value <= hint.bounds.hi[axis], "{kind:?}");
                        assert!(kind == Kind::Soup || f64::from(value as f32) == value, "{kind:?}: {value}");
                    }
                    edges.push((0..3).map(|i| (corner[i] - next[i]).powi(2)).sum::<f64>().sqrt());
                }
            }
            let middle = edges.len() / 2;
            let median = *edges.select_nth_unstable_by(middle, f64::total_cmp).1;
            let part = hint.median_edge / median;
            assert!((0.5..=1.0).contains(&part), "{kind:?} {triangles}: hint is {part} of {median}");
        }
    }
}

#[test]
fn materials_are_valid_and_all_indices_name_one() {
    for kind in Kind::ALL {
        let mut source = open(kind, 100_000, 2);
        let all = collect(&mut *source);
        let materials = source.materials();
        assert!(!materials.is_empty());
        for material in materials.iter() {
            assert_eq!(*material, material.checked());
        }
        let mut used = vec![0u64; materials.len()];
        for &material in &all.material {
            used[material as usize] += 1;
        }
        assert!(
            used.iter().filter(|&&count| count > 0).count() * 10 >= 9 * materials.len(),
            "{kind:?}: {used:?}"
        );
    }
}

#[test]
fn the_plant_has_many_materials_mirrors_and_eleven_lamps_that_shine_down() {
    let mut source = open(Kind::Pipes, 100_000, 2);
    let all = collect(&mut *source);
    let materials = source.materials();
    assert!(materials.len() >= 24 && materials.iter().filter(|material| material.mirror).count() >= 2);
    let mut lamp_triangles = 0;
    for ([a, b, c], &material) in all.corners.iter().zip(&all.material) {
        if materials[material as usize].emits() {
            let up = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2]);
            assert!(up < 0.0 && a[1] == b[1] && b[1] == c[1]);
            lamp_triangles += 1;
        }
    }
    assert_eq!(lamp_triangles, 22);
}

#[test]
fn the_soup_holds_its_degenerates() {
    for triangles in [10_000, 12_371] {
        let all = collect(&mut *open(Kind::Soup, triangles, 2));
        let equal = |[a, b, c]: &&[[f64; 3]; 3]| a == b || b == c || a == c;
        assert_eq!(all.len() as u64, triangles);
        assert_eq!(
            all.corners.iter().filter(equal).count() as u64,
            datasets_gen::degenerate_count(triangles)
        );
    }
}

#[test]
fn views_start_with_the_overview_and_stay_finite() {
    for kind in Kind::ALL {
        for triangles in [10_000, 1_000_000_000] {
            let views = views(&Spec { kind, triangles, seed: 1, colours: None });
            assert_eq!(views[0].name, "overview");
            assert_eq!(kind == Kind::Pipes, views.iter().any(|view| view.name == "interior"));
            for view in views {
                assert!(view.position.iter().chain(&view.target).all(|value| value.is_finite()));
                assert_ne!(view.position, view.target);
            }
        }
    }
}

#[test]
fn memory_is_leased_and_interrupts_stop() {
    for kind in Kind::ALL {
        let spec = Spec { kind, triangles: 50_000, seed: 1, colours: None };
        let tight = Budget::new(trex_store::RESERVE_BYTES + (1 << 20));
        let options = GenOptions { threads: 2, budget: tight, ..GenOptions::default() };
        let refused = datasets_gen::open(&spec, &options).err().expect("one MiB is too little");
        assert_eq!(refused.code(), Code::MemoryLimit);

        let (budget, interrupt) = (Budget::unlimited(), Interrupt::default());
        let options = GenOptions { threads: 16, budget: budget.clone(), interrupt: interrupt.clone() };
        let mut source = datasets_gen::open(&spec, &options).unwrap();
        assert!(budget.peak_bytes() < 256 << 20, "{}", budget.peak_bytes());
        let mut batch = TriangleBatch::default();
        assert!(source.next_batch(&mut batch).unwrap());
        interrupt.raise();
        assert_eq!(source.next_batch(&mut batch).unwrap_err().code(), Code::Interrupted);
        drop(source);
        assert_eq!(budget.used_bytes(), 0);
    }
}
