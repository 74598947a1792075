// Handles of sections: the foot of a plane against its distance, and a drag against where the camera sees the handle.

import assert from "node:assert/strict";
import { test } from "node:test";
import { page, random } from "./page.js";

const { foot, way_of_drag } = await page("section_handles");
const { project, shift_at } = await page("camera");
const { add, dot, scale, subtract, unit } = await page("vector");

const SIZE = [900, 600];
const CAMERA = { position: [3, 2, 9], target: [0, 0.5, 0], up: [0, 1, 0], fov_y: 45 };

test("the foot of a point lies on the plane, straight below it", () => {
  for (let seed = 1; seed <= 20; seed += 1) {
    const [px, py, pz, a, b, c, x, y, z] = [...random(seed, 9)].map((number) => 4 * number - 2);
    const [plane, point] = [[px, py, pz, a, b, c], [x, y, z]];
    const found = foot(plane, point);
    assert.ok(Math.abs(dot(subtract(found, [px, py, pz]), [a, b, c])) < 1e-9);
    const way = subtract(point, found);
    assert.ok(Math.abs(dot(way, way) * dot([a, b, c], [a, b, c]) - dot(way, [a, b, c]) ** 2) < 1e-9);
  }
});

test("the handle goes with the hand, as far as its normal is seen", () => {
  let judged = 0;
  for (let seed = 1; seed <= 40; seed += 1) {
    const [a, b, c, x, y] = [...random(seed, 5)].map((number) => 2 * number - 1);
    const rule = unit([a, b, c]);
    const handle = foot([x, y, 0.3, ...rule], CAMERA.target);
    const at = project(CAMERA, SIZE, handle);
    const [right, up] = [[1, 0], [0, -1]].map((way) => shift_at(CAMERA, SIZE, at.depth, ...way));
    // A pixel along the normal, as the camera sees it.
    const end = project(CAMERA, SIZE, add(handle, scale(rule, 1e-3)));
    const far = Math.hypot(end.x - at.x, end.y - at.y);
    const steep = far < 0.2 * 1e-3 * (SIZE[1] / (2 * Math.tan(Math.PI / 8) * at.depth));
    if (steep || at.depth < 1) {
      continue;
    }
    judged += 1;
    const [dx, dy] = [(end.x - at.x) / far, (end.y - at.y) / far];
    const moved = project(CAMERA, SIZE, add(handle, scale(rule, way_of_drag(rule, right, up, dx, dy))));
    // The picture is in perspective, so a normal that leans to the viewer goes a little further.
    assert.ok(Math.hypot(moved.x - at.x - dx, moved.y - at.y - dy) < 0.35, `${seed}`);
    // Across the normal it stays.
    assert.ok(Math.abs(way_of_drag(rule, right, up, -dy, dx)) < 0.5 * Math.hypot(...right), `${seed}`);
  }
  assert.ok(judged > 25, `${judged}`);
});

test("a plane that faces the viewer goes away when the hand goes up", () => {
  const [right, up] = [[0.01, 0, 0], [0, 0.01, 0]];
  assert.ok(Math.abs(way_of_drag([0, 0, 1], right, up, 5, -10) + 0.1) < 1e-12);
  assert.ok(Math.abs(way_of_drag([0, 0, -1], right, up, 5, -10) - 0.1) < 1e-12);
});
