//! The ways of a camera that a hand moves: `drag` about the model, `fly` through it.
//!
//! ```text
//! drag  a quarter of an orbit -> a pan -> a zoom
//! fly   from view to view, along straight lines, as long a time from each to the next
//! ```
//!
//! Invariants: 1. a camera is a function of the views and the event; 2. the last view of a way is that of its last
//! event.

use super::vector::{along, cross, length, turned_about, unit};
use trex_render::Camera;

/// Events of a way, and the views of it that have references.
pub(super) const WAY_EVENTS: u32 = 150;
pub(super) const WAY_VIEWS: u32 = 12;
/// Events of the orbit of a drag, and of its pan.
const ORBIT_EVENTS: u32 = 90;
const PAN_EVENTS: u32 = 30;
/// Turns of its orbit; how far it pans, and how near it comes, as shares of the way to the target.
const TURNS: f64 = 0.25;
const PAN: f64 = 0.15;
const ZOOM: f64 = 0.4;

/// The event after which the scene is in state `view`.
pub(super) fn event_of(view: u32) -> u32 {
    (view + 1) * WAY_EVENTS / WAY_VIEWS - 1
}

/// The last state that event `index` has come to.
pub(super) fn view_of(index: u32) -> u32 {
    (1..WAY_VIEWS).take_while(|view| event_of(*view) <= index).last().unwrap_or(0)
}

/// The camera after event `index` of a drag: it orbits what `from` looks at, about the axis `up`.
pub(super) fn drag(from: &Camera, up: [f64; 3], index: u32) -> Camera {
    let part =
        |first: u32, count: u32| (f64::from((index + 1).saturating_sub(first)) / f64::from(count)).min(1.0);
    let orbited = part(0, ORBIT_EVENTS);
    let panned = part(ORBIT_EVENTS, PAN_EVENTS);
    let zoom_first = ORBIT_EVENTS + PAN_EVENTS;
    let zoomed = part(zoom_first, WAY_EVENTS - zoom_first);
    let camera = turned_about(from.target, up, from, TURNS * orbited);
    let way: [f64; 3] = std::array::from_fn(|a| camera.target[a] - camera.position[a]);
    let side = unit(cross(way, up));
    let aside = PAN * panned * length(way);
    let target = along(camera.target, aside, side);
    let position = along(along(camera.position, aside, side), ZOOM * zoomed, way);
    Camera { position, target, ..camera }
}

/// The camera after event `index` of a flight from view to view of `views`.
///
/// # Panics
/// When there are no views.
pub(super) fn fly(views: &[Camera], index: u32) -> Camera {
    let legs = views.len().saturating_sub(1).max(1);
    let flown = f64::from(index + 1) / f64::from(WAY_EVENTS) * legs as f64;
    let leg = (flown as usize).min(legs - 1);
    let (from, to) = (&views[leg], &views[(leg + 1).min(views.len() - 1)]);
    let part = flown - leg as f64;
    let between = |a: [f64; 3], b: [f64; 3]| std::array::from_fn(|i| a[i] + part * (b[i] - a[i]));
    let position = between(from.position, to.position);
    let look = |camera: &Camera| unit(std::array::from_fn(|a| camera.target[a] - camera.position[a]));
    // Views that look in opposite directions have a moment without one, or with one that is up: the next view's is as
    // good.
    let direction = between(look(from), look(to));
    let is_a_view = length(direction) > 1e-3 && length(cross(unit(direction), unit(to.up))) > 1e-2;
    let direction = if is_a_view { unit(direction) } else { look(to) };
    let ahead = |camera: &Camera| length(std::array::from_fn(|a| camera.target[a] - camera.position[a]));
    let distance = ahead(from) + part * (ahead(to) - ahead(from));
    Camera { position, target: along(position, distance, direction), ..*to }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trex_store::Aabb;

    fn view(position: [f64; 3], target: [f64; 3]) -> Camera {
        let bounds = Aabb { lo: [0.0; 3], hi: [8.0, 2.0, 8.0] };
        Camera { position, target, ..Camera::framing(&bounds, [64, 64], None, None) }
    }

    fn near(a: [f64; 3], b: [f64; 3]) -> bool {
        (0..3).all(|i| (a[i] - b[i]).abs() < 1e-9)
    }

    /// From the place before each event to that after it.
    fn steps(way: impl Fn(u32) -> Camera) -> Vec<f64> {
        let places: Vec<_> = (0..WAY_EVENTS).map(|event| way(event).position).collect();
        let step = |pair: &[[f64; 3]]| length(std::array::from_fn(|a| pair[1][a] - pair[0][a]));
        places.windows(2).map(step).collect()
    }

    /// A quarter of an orbit about the target, then a way to the right, then nearer: each step alone.
    #[test]
    fn a_drag_orbits_pans_and_zooms_in_small_steps() {
        let (up, target) = ([0.0, 1.0, 0.0], [1.0, 1.0, 1.0]);
        let from = view([5.0, 1.0, 1.0], target);
        let end = |event: u32| (drag(&from, up, event - 1).position, drag(&from, up, event - 1).target);
        let (orbited, seen) = end(90);
        assert!(near(seen, target) && near(orbited, [1.0, 1.0, -3.0]), "{orbited:?}");
        // It looks along +z there, with +y up: right is -x.
        let (panned, seen) = end(120);
        assert!(near(panned, [0.4, 1.0, -3.0]) && near(seen, [0.4, 1.0, 1.0]), "{panned:?} {seen:?}");
        let (zoomed, seen_nearer) = end(150);
        assert!(near(zoomed, [0.4, 1.0, -1.4]) && near(seen_nearer, seen), "{zoomed:?}");
        assert!(steps(|event| drag(&from, up, event)).iter().all(|step| *step > 0.01 && *step < 0.1));
    }

    #[test]
    fn a_flight_passes_each_view_and_ends_at_the_last() {
        let views = [
            view([0.0, 0.0, 0.0], [4.0, 0.0, 0.0]),
            view([6.0, 0.0, 0.0], [6.0, 0.0, 2.0]),
            view([6.0, 0.0, 3.0], [6.0, 0.0, 4.0]),
        ];
        for (event, place) in [(75, 1), (150, 2)] {
            let camera = fly(&views, event - 1);
            assert!(near(camera.position, views[place].position), "{camera:?}");
            assert!(near(camera.target, views[place].target), "{camera:?}");
        }
        // Halfway of a leg it looks halfway between what the two look at.
        let camera = fly(&views[..2], 74);
        let look: [f64; 3] = std::array::from_fn(|a| camera.target[a] - camera.position[a]);
        assert!(near(camera.position, [3.0, 0.0, 0.0]) && near(unit(look), unit([1.0, 0.0, 1.0])));
        assert!(steps(|event| fly(&views, event)).iter().all(|step| *step > 0.03 && *step < 0.1));
        // Round about on the spot, and one view alone: no step without a direction.
        let back = [view([0.0; 3], [1.0, 0.0, 0.0]), view([0.0; 3], [-1.0, 0.0, 0.0])];
        let raised = [view([0.0; 3], [1.0, 0.1, 0.0]), view([0.0; 3], [-1.0, 0.1, 0.0])];
        for views in [&back[..], &back[..1], &raised[..]] {
            for event in 0..WAY_EVENTS {
                let camera = fly(views, event);
                assert!(camera.target != camera.position && camera.project([64, 64]).is_ok(), "{camera:?}");
            }
        }
    }

    /// Each state is that of one event, and the last is that of the rest.
    #[test]
    fn views_with_references_lie_on_the_way_and_end_it() {
        let events: Vec<u32> = (0..WAY_VIEWS).map(event_of).collect();
        assert!(events.windows(2).all(|pair| pair[0] < pair[1]) && events[11] == WAY_EVENTS - 1);
        assert!((0..WAY_VIEWS).all(|view| view_of(events[view as usize]) == view));
    }
}
