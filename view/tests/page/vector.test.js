// Vectors: rotations beside matrices, directions across beside the definition of "across".

import assert from "node:assert/strict";
import { test } from "node:test";
import { page, random } from "./page.js";

const { across, cross, distance, is_finite, length, middle, rotate, unit } = await page("vector");

const near = (a, b) => a.forEach((part, at) => assert.ok(Math.abs(part - b[at]) < 1e-12, `${a} is not ${b}`));

test("a turn is that of the matrix of its axis", () => {
  for (const angle of [0, 0.3, -2, Math.PI, 7]) {
    const [s, c] = [Math.sin(angle), Math.cos(angle)];
    const [x, y, z] = [2, -3, 5];
    near(rotate([x, y, z], [1, 0, 0], angle), [x, c * y - s * z, s * y + c * z]);
    near(rotate([x, y, z], [0, 1, 0], angle), [c * x + s * z, y, c * z - s * x]);
    near(rotate([x, y, z], [0, 0, 1], angle), [c * x - s * y, s * x + c * y, z]);
  }
  // By a third of a turn about the diagonal, each axis goes to the next.
  const third = Math.sqrt(1 / 3);
  near(rotate([1, 2, 3], [third, third, third], (2 * Math.PI) / 3), [3, 1, 2]);
});

test("a cross product is across both, in the order of the axes", () => {
  assert.deepEqual(cross([1, 0, 0], [0, 1, 0]), [0, 0, 1]);
  assert.deepEqual(cross([0, 1, 0], [0, 0, 1]), [1, 0, 0]);
  assert.deepEqual(cross([2, 3, 4], [5, 6, 7]), [-3, 6, -3]);
});

test("a unit vector has length 1, or is the fallback", () => {
  near(unit([3, 0, -4]), [0.6, 0, -0.8]);
  near(unit([1e200, 0, 0]), [1, 0, 0]);
  const fallback = [0, 1, 0];
  for (const none of [[0, 0, 0], [NaN, 1, 1], [Infinity, 0, 0]]) {
    assert.deepEqual(unit(none, fallback), [0, 1, 0]);
    assert.notEqual(unit(none, fallback), fallback, "a list of its own");
  }
});

test("across an axis there is always a direction, the same one", () => {
  const numbers = [...random(7, 60)].map((number) => 2 * number - 1);
  const axes = [[1, 0, 0], [0, -1, 0], [0, 0, 1], [1, 1, 0], [1, 1, 1], [1e-9, 0, 1]];
  for (let at = 0; at + 3 <= numbers.length; at += 3) {
    axes.push(numbers.slice(at, at + 3));
  }
  for (const axis of axes) {
    const [x, y, z] = across(axis);
    assert.ok(Math.abs(x * axis[0] + y * axis[1] + z * axis[2]) < 1e-12, `${axis}`);
    assert.ok(Math.abs(x * x + y * y + z * z - 1) < 1e-12, `${axis}`);
    assert.deepEqual(across(axis), [x, y, z]);
  }
});

test("lengths and middles", () => {
  assert.equal(length([2, 3, 6]), 7);
  assert.equal(distance([1, 1, 1], [3, 4, 7]), 7);
  assert.deepEqual(middle([1, 2, 3], [3, 6, -3]), [2, 4, 0]);
  assert.deepEqual([[1, 2, 3], [1, 2], [1, 2, NaN], "123", null, [1, 2, "3"]].map(is_finite),
    [true, false, false, false, false, false]);
});
