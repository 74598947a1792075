// The camera and how the hand moves it: pure functions from one camera to the next, in f64.
//
// A camera is {position, target, up, fov_y}: model units, degrees from the lower to the upper edge.
// Invariants: 1. the distance to the target stays within REACH of the model's extent; 2. the view never runs along
// up: it keeps POLE_ANGLE off it; 3. no function changes its arguments.

import { across, add, cross, distance, dot, is_finite, length, rotate, scale, subtract, unit } from "./vector.js";

/** Least and greatest distance to the target, in extents of the model: f64 has digits to spare for both. */
const REACH = [1e-9, 1e9];
/** The view stays this far off up, radians. */
const POLE_ANGLE = 0.002;
/** A drag across the picture's height turns by this much, radians. */
const TURN_PER_HEIGHT = Math.PI;
/** Views by number: the way from the camera to the model, in [right, up, front] of the model's ground. */
const NUMBERED = { front: [0, 0, -1], right: [-1, 0, 0], top: [0, -1, -1e-2], isometric: [-1, -1, -1] };

/** True for what can be sent as a camera. */
export function is_camera(camera) {
  return Boolean(camera) && is_finite(camera.position) && is_finite(camera.target) && is_finite(camera.up)
    && Number.isFinite(camera.fov_y) && camera.fov_y >= 0.001 && camera.fov_y <= 179
    && distance(camera.position, camera.target) > 0;
}

export function same(a, b) {
  const numbers = (camera) => [...camera.position, ...camera.target, ...camera.up, camera.fov_y];
  const others = numbers(b);
  return numbers(a).every((number, at) => number === others[at]);
}

/** Length of the diagonal of the model's box, never 0. */
export function extent(bounds) {
  return distance(bounds.lo, bounds.hi) || 1;
}

/** Unit vectors of the picture: right, up, and forward into it. */
export function frame(camera) {
  const forward = unit(subtract(camera.target, camera.position));
  const right = unit(cross(forward, camera.up), across(forward));
  return { right, up: cross(right, forward), forward };
}

/** Half the picture's height at distance 1. */
const half_height = (camera) => Math.tan((camera.fov_y * Math.PI) / 360);

/** Where a point lies in a picture of `size`: {x, y, depth}; depth <= 0 is behind the camera. */
export function project(camera, size, point) {
  const { right, up, forward } = frame(camera);
  const way = subtract(point, camera.position);
  const depth = dot(way, forward);
  const pixels = size[1] / 2 / (half_height(camera) * depth);
  return { x: size[0] / 2 + dot(way, right) * pixels, y: size[1] / 2 - dot(way, up) * pixels, depth };
}

/** The shift of the plane parallel to the picture at `depth` that `dx`, `dy` pixels of it are. */
export function shift_at(camera, size, depth, dx, dy) {
  const { right, up } = frame(camera);
  const per_pixel = (2 * half_height(camera) * depth) / size[1];
  return add(scale(right, dx * per_pixel), scale(up, -dy * per_pixel));
}

/** Turns the camera about its target, as a drag by `dx`, `dy` of a picture `height` tall does: the model follows. */
export function orbit(camera, height, dx, dy) {
  const turn = TURN_PER_HEIGHT / height;
  const offset = subtract(camera.position, camera.target);
  return { ...camera, position: add(camera.target, turned(camera, offset, -dx * turn, -dy * turn)) };
}

/** Turns the view about the camera itself: what is seen follows the hand. */
export function look(camera, height, dx, dy) {
  const turn = (camera.fov_y * Math.PI) / 180 / height;
  const way = subtract(camera.target, camera.position);
  return { ...camera, target: add(camera.position, turned(camera, way, dx * turn, -dy * turn)) };
}

/** `way`, to or from the camera, turned about up by `yaw` and away from up by `fall` radians; kept off the poles. */
function turned(camera, way, yaw, fall) {
  const axis = unit(camera.up);
  const { right, forward } = frame(camera);
  const polar = Math.acos(Math.max(-1, Math.min(1, dot(unit(way), axis))));
  const wanted = Math.max(POLE_ANGLE, Math.min(Math.PI - POLE_ANGLE, polar + fall));
  const about_right = dot(way, forward) < 0 ? wanted - polar : polar - wanted;
  return rotate(rotate(way, right, about_right), axis, yaw);
}

/** Shifts the camera so that what lies at the target's depth follows the hand. */
export function pan(camera, size, dx, dy) {
  const depth = distance(camera.position, camera.target);
  return moved(camera, shift_at(camera, size, depth, -dx, -dy));
}

/** Camera and target both shifted. */
export function moved(camera, shift) {
  return { ...camera, position: add(camera.position, shift), target: add(camera.target, shift) };
}

/** Comes closer by `factor` (< 1 is nearer); what is at `x`, `y` at the target's depth stays where it is. */
export function zoom(camera, size, model_extent, factor, x, y) {
  const depth = distance(camera.position, camera.target);
  const allowed = Math.max(REACH[0] * model_extent, Math.min(REACH[1] * model_extent, depth * factor));
  const by = allowed / depth;
  const fixed = add(camera.target, shift_at(camera, size, depth, x - size[0] / 2, y - size[1] / 2));
  const towards = (point) => add(fixed, scale(subtract(point, fixed), by));
  return { ...camera, position: towards(camera.position), target: towards(camera.target) };
}

/** Flies by `step` = [right, up, forward] in model units. */
export function fly(camera, step) {
  const { right, forward } = frame(camera);
  const up = unit(camera.up);
  return moved(camera, add(add(scale(right, step[0]), scale(up, step[1])), scale(forward, step[2])));
}

/** Turns the picture about its middle by `angle` radians. */
export function roll(camera, angle) {
  const { up, forward } = frame(camera);
  return { ...camera, up: rotate(up, forward, angle) };
}

/** Looks at `point` from where the camera stands. */
export function look_at(camera, point) {
  return { ...camera, target: [...point] };
}

/** The whole model from one of the sides of NUMBERED, at the angle of view of `camera`. */
export function numbered(name, camera, bounds, model_up, aspect) {
  const axis = unit(model_up, [0, 1, 0]);
  // The ground's axes: for y up the front looks along -z; for z up along +y.
  const front = Math.abs(axis[1]) > 0.9 ? [0, 0, 1] : Math.abs(axis[2]) > 0.9 ? [0, -1, 0] : across(axis);
  const right = unit(cross(axis, front));
  const [sideways, upwards, towards] = NUMBERED[name];
  const direction = unit(add(add(scale(right, sideways), scale(axis, upwards)), scale(front, towards)));
  const center = scale(add(bounds.lo, bounds.hi), 0.5);
  const half = half_height(camera) * Math.min(1, aspect);
  const radius = extent(bounds) / 2;
  const far = radius / Math.sin(Math.atan(half));
  return { ...camera, up: axis, target: center, position: subtract(center, scale(direction, far)) };
}

const NUMBERS_OF_A_VIEW = 10;

/** A view as a URL's fragment has it: ten numbers, shortest digits that read back the same. A plus is a space there. */
export function to_text(camera) {
  return [...camera.position, ...camera.target, ...camera.up, camera.fov_y].join(",").replaceAll("+", "");
}

/** The view that `to_text` wrote; null for anything else. */
export function from_text(text) {
  const numbers = String(text ?? "").split(",").map((word) => (word.trim() === "" ? NaN : Number(word)));
  if (numbers.length !== NUMBERS_OF_A_VIEW) {
    return null;
  }
  const [position, target, up] = [0, 3, 6].map((at) => numbers.slice(at, at + 3));
  const camera = { position, target, up, fov_y: numbers[9] };
  return is_camera(camera) && length(cross(up, subtract(target, position))) > 0 ? camera : null;
}
