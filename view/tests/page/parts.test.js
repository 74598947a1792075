// Sections and hidden materials: planes held against signed distances, wishes against sets.

import assert from "node:assert/strict";
import { test } from "node:test";
import { page, random } from "./page.js";

const { Parts, at_offset, axis_of, nearest_axis, offsets, rule_of, wish_of } = await page("parts");
const { Wishes } = await page("wishes");

/** Most materials that a message names, as `view/src/wire.rs` has it. */
const PARTS_MAX = 4096;
const BOX = { lo: [-1, 2, -3], hi: [4, 5, 6] };
const times = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

test("a normal along an axis names it", () => {
  assert.deepEqual([[1, 0, 0], [0, -1, 0], [0, 0, 0.5], [-0, 0, 1]].map(axis_of), [0, 1, 2, 2]);
  assert.deepEqual([[1, 1, 0], [0, 0, 0], [1e-9, 0, 1]].map(axis_of), [-1, -1, -1]);
});

test("the nearest axis is that of the greatest part, with its sign", () => {
  assert.deepEqual(nearest_axis([0.1, -0.9, 0.3]), [0, -1, 0]);
  assert.deepEqual(nearest_axis([0.7, 0.6, -0.5]), [1, 0, 0]);
  assert.deepEqual(nearest_axis([0, 0, -1]), [0, 0, -1]);
});

test("an offset grows along the axis, whichever side is kept", () => {
  assert.deepEqual(rule_of([0, -1, 0]), [0, 1, 0]);
  assert.deepEqual(rule_of([0, 0, 1]), [0, 0, 1]);
  const leaning = [0.6, 0, -0.8];
  assert.deepEqual(rule_of(leaning), leaning);
});

test("the offsets of a box are those of its corners", () => {
  for (let seed = 1; seed <= 20; seed += 1) {
    const rule = [...random(seed, 3)].map((number) => 2 * number - 1);
    const corners = Array.from({ length: 8 }, (_, corner) =>
      times(rule, [0, 1, 2].map((axis) => ((corner >> axis) & 1 ? BOX.hi : BOX.lo)[axis])));
    const [least, most] = offsets(BOX, rule);
    assert.ok(Math.abs(least - Math.min(...corners)) < 1e-12 && Math.abs(most - Math.max(...corners)) < 1e-12);
  }
  assert.deepEqual(offsets(BOX, [0, 1, 0]), [2, 5]);
});

test("a plane that is moved to an offset has it, and keeps its normal", () => {
  // Along an axis the number is the coordinate itself, in every bit.
  assert.deepEqual(at_offset([0.3, 0.7, 9, 0, -1, 0], 0.1), [0.3, 0.1, 9, 0, -1, 0]);
  for (let seed = 1; seed <= 20; seed += 1) {
    const [x, y, z, around, above, far] = random(seed, 6);
    const [a, b] = [6.28 * around, 3 * above - 1.5];
    const normal = [Math.cos(a) * Math.cos(b), Math.sin(a) * Math.cos(b), Math.sin(b)];
    const plane = at_offset([x, y, z, ...normal], 8 * far - 4);
    assert.deepEqual(plane.slice(3), normal);
    assert.ok(Math.abs(times(plane.slice(0, 3), normal) - (8 * far - 4)) < 1e-12);
    // It goes the shortest way: along its normal.
    const way = [plane[0] - x, plane[1] - y, plane[2] - z];
    assert.ok(Math.abs(times(way, way) - times(way, normal) ** 2) < 1e-12);
  }
});

test("a wish names the shorter list of materials, and none that was not told", () => {
  const section = [[0, 0, 0, 1, 0, 0]];
  assert.deepEqual(wish_of({ section, hide: [2], only: null }), { section, hide: [2] });
  assert.deepEqual(wish_of({ section, hide: null, only: [3] }), { section, only: [3] });
  assert.deepEqual(wish_of({ section, hide: null, only: null }), { section });
  assert.deepEqual(wish_of({ section, hide: [2], only: null }, new Set([10, 9, 2]), 20), { section, hide: [2, 9, 10] });
  const count = 3 * PARTS_MAX;
  const all_but = (shown) => new Set(Array.from({ length: count }, (_, at) => at).filter((at) => !shown.includes(at)));
  assert.deepEqual(wish_of({ section, hide: [] }, all_but([7, 8]), count), { section, only: [7, 8] });
  const most = new Set(Array.from({ length: PARTS_MAX }, (_, at) => at));
  assert.equal(wish_of({ section, hide: [] }, most, count).hide.length, PARTS_MAX);
  // Neither list is short enough to be told.
  const half = new Set(Array.from({ length: count / 2 }, (_, at) => at));
  assert.equal(wish_of({ section, hide: [] }, half, count), null);
});

/** The panel over a page that may edit or not: what it says and what it sends. */
function panel(parts, { may_edit = true, material_count = 5 } = {}) {
  const [said, sent, frames] = [[], [], []];
  globalThis.requestAnimationFrame = (call) => frames.push(call);
  const edit = (message) => sent.push(message.parts);
  const app = { state: { parts, material_count }, may_edit: () => may_edit, edit, wishes: new Wishes() };
  const made = new Parts(app, { say: (text) => said.push(text), rebuild() {} });
  // Does `call`, and gives what the page has asked for by the next animation frame.
  const asks = (call) => {
    call(made);
    frames.splice(0).forEach((frame) => frame());
    return sent.at(-1);
  };
  return { made, asks, said, sent };
}

const WHOLE = { section: [], hidden_count: 0, hide: [], only: null };

test("what is hidden is known from either list", () => {
  const hide = panel({ ...WHOLE, hide: [1, 3], hidden_count: 2 }).made;
  const only = panel({ ...WHOLE, hide: null, only: [0, 2, 4], hidden_count: 2 }).made;
  for (const made of [hide, only]) {
    assert.deepEqual([0, 1, 2, 3, 4].map((index) => made.hides(index)), [false, true, false, true, false]);
    assert.deepEqual([...made.hidden], [1, 3]);
  }
  const untold = panel({ ...WHOLE, hide: null, only: null, hidden_count: 9 }).made;
  assert.equal(untold.hidden, null);
  assert.equal(untold.hides(1), false);
});

test("an eye hides and shows again", () => {
  const { made, asks } = panel(WHOLE);
  assert.deepEqual(asks(() => made.toggle(2)), { section: [], hide: [2] });
  assert.equal(made.parts.hidden_count, 1);
  assert.ok(made.app.wishes.is_unknown_to(0, "parts"), "what the server says of before is not taken");
  assert.deepEqual(asks(() => made.toggle(2)), { section: [], hide: [] });
  assert.deepEqual(asks(() => made.only(4)), { section: [], only: [4] });
  assert.equal(made.parts.hidden_count, 4);
  assert.deepEqual(asks(() => made.show_all()), { section: [], hide: [] });
});

/** A page that only watches said that a material was hidden, which stayed in the picture. */
test("what was not hidden is not said to be", () => {
  const hit = { material: 2, name: "tent" };
  const driving = panel(WHOLE);
  driving.asks((made) => made.hit(hit));
  assert.deepEqual(driving.said, ["tent is hidden"]);
  const watching = panel(WHOLE, { may_edit: false });
  watching.asks((made) => made.hit(hit));
  assert.deepEqual([watching.said, watching.sent], [[], []]);
  // A list that is too long to be told is left as it is.
  const untold = panel({ ...WHOLE, hide: null, only: null, hidden_count: 9000 }, { material_count: 20_000 });
  untold.asks((made) => made.hit(hit));
  assert.deepEqual([untold.said, untold.sent], [[], []]);
});
