//! Turns: contenders one after the other on one set, round by round.

use super::contender::{Contender, RayAnswer};
use super::figures::{ModeSet, SingleFigures};
use super::peer::PeerSetup;
use super::sets::RaySet;
use crate::median::median;
use std::time::Instant;

/// Ours, and where it takes batches, the same for single rays.
pub(super) struct OwnContender<'a> {
    pub(super) contender: &'a mut dyn Contender,
    pub(super) single: Option<&'a mut dyn Contender>,
}

impl<'a> OwnContender<'a> {
    /// Rays that go one by one.
    pub(super) fn alone(contender: &'a mut dyn Contender) -> OwnContender<'a> {
        OwnContender { contender, single: None }
    }
}

/// What the rounds on one set gave.
pub(super) struct Turns {
    pub(super) per_s: f64,
    pub(super) per_core_s: f64,
    pub(super) single: Option<SingleFigures>,
    pub(super) modes: Vec<ModeSet>,
    pub(super) ours: Vec<RayAnswer>,
    /// Answers of the peer's reference mode.
    pub(super) reference: Vec<RayAnswer>,
}

/// One round to warm up, then measured rounds; in each, ours and every mode in turn.
pub(super) fn take_turns(
    ours: OwnContender<'_>,
    mut peer: Option<&mut PeerSetup>,
    set: &RaySet,
    rounds: usize,
) -> Turns {
    let OwnContender { contender: ours, mut single } = ours;
    let mode_count = peer.as_ref().map_or(0, |peer| peer.modes.len());
    let mut first = vec![RayAnswer::NONE; set.rays.len()];
    let mut answers = first.clone();
    let mut reference = Vec::new();
    let mut our_speeds = Vec::with_capacity(rounds);
    let mut single_speeds = Vec::with_capacity(rounds);
    let mut mode_speeds = vec![Vec::with_capacity(rounds); mode_count];
    ours.trace(set, &mut first);
    for round in 0..=rounds {
        let speed = timed(ours, set, &mut answers);
        assert!(answers == first, "a round gave other answers than the first");
        if round > 0 {
            our_speeds.push(speed);
        }
        if let Some(single) = &mut single {
            let speed = timed(&mut **single, set, &mut answers);
            assert!(answers == first, "single rays have other answers than batches");
            if round > 0 {
                single_speeds.push(speed);
            }
        }
        let Some(peer) = &mut peer else { continue };
        for ((mode, _), speeds) in peer.modes.iter_mut().zip(&mut mode_speeds) {
            let speed = timed(&mut **mode, set, &mut answers);
            if round > 0 {
                speeds.push(speed);
            } else if mode.label() == peer.reference {
                reference.clone_from(&answers);
            }
        }
    }
    let modes = mode_speeds.iter().map(|speeds| ModeSet {
        per_s: middle(speeds, |speed| speed.wall),
        per_core_s: middle(speeds, |speed| speed.core),
        ratio: median(&our_speeds.iter().zip(speeds).map(|(a, b)| a.core / b.core).collect::<Vec<_>>()),
        single_ratio: single.is_some().then(|| {
            median(&single_speeds.iter().zip(speeds).map(|(a, b)| a.core / b.core).collect::<Vec<_>>())
        }),
        wall_ratio: median(&our_speeds.iter().zip(speeds).map(|(a, b)| a.wall / b.wall).collect::<Vec<_>>()),
    });
    Turns {
        per_s: middle(&our_speeds, |speed| speed.wall),
        per_core_s: middle(&our_speeds, |speed| speed.core),
        single: single.is_some().then(|| SingleFigures {
            per_s: middle(&single_speeds, |speed| speed.wall),
            per_core_s: middle(&single_speeds, |speed| speed.core),
        }),
        modes: modes.collect(),
        ours: first,
        reference,
    }
}

/// Rays per second of one round.
#[derive(Clone, Copy)]
struct Speed {
    /// Of wall time.
    wall: f64,
    /// Of processor time.
    core: f64,
}

fn middle(speeds: &[Speed], of: fn(&Speed) -> f64) -> f64 {
    median(&speeds.iter().map(of).collect::<Vec<_>>())
}

/// The speed of one trace of the set.
fn timed(contender: &mut dyn Contender, set: &RaySet, answers: &mut [RayAnswer]) -> Speed {
    let start = Instant::now();
    let used = contender.trace(set, answers);
    let rays = set.rays.len() as f64;
    Speed { wall: rays / start.elapsed().as_secs_f64(), core: rays / used.as_secs_f64().max(1e-9) }
}
