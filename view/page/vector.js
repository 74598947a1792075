// Vectors of three numbers, in f64: plain arrays in, new arrays out. Nothing here changes its arguments.

export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const subtract = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const scale = (a, factor) => [a[0] * factor, a[1] * factor, a[2] * factor];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const length = (a) => Math.hypot(a[0], a[1], a[2]);
export const distance = (a, b) => length(subtract(a, b));
export const middle = (a, b) => scale(add(a, b), 0.5);
export const is_finite = (a) => Array.isArray(a) && a.length === 3 && a.every(Number.isFinite);

export const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];

/** `a` at length 1; `fallback` where it has no direction. */
export function unit(a, fallback = [0, 0, 1]) {
  const size = length(a);
  return size > 0 && Number.isFinite(size) ? scale(a, 1 / size) : [...fallback];
}

/** `a` turned about the unit vector `axis` by `angle` radians (Rodrigues). */
export function rotate(a, axis, angle) {
  const [sin, cos] = [Math.sin(angle), Math.cos(angle)];
  const along = scale(axis, dot(axis, a) * (1 - cos));
  return add(add(scale(a, cos), scale(cross(axis, a), sin)), along);
}

/** A unit vector across `axis`: any, but always the same. */
export function across(axis) {
  const least = axis.map(Math.abs).reduce((best, size, at, all) => (size < all[best] ? at : best), 0);
  const other = [0, 0, 0];
  other[least] = 1;
  return unit(cross(axis, other));
}
