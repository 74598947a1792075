// The line at the bottom, over elements that are plain objects; plots; the measure of two points.

import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { page } from "./page.js";

const { keep_status } = await page("status");
const { Plot } = await page("plot");
const { Measure } = await page("measure");
const { once_a_frame } = await page("widgets");

let parts;
const made = () => ({ style: {}, dataset: {}, setAttribute() {}, addEventListener() {} });
beforeEach(() => {
  parts = {};
  globalThis.document = { getElementById: (name) => (parts[name] ??= made()), createElement: made, body: made() };
});

/** The status of an application, and how to tell it something. */
function status(state = {}) {
  const listeners = {};
  const app = { state, link: "open", connection: { is_open: true }, panels: { open() {} },
    listen: (key, call) => { listeners[key] = call; } };
  keep_status(app);
  return { app, tell: (key, value) => listeners[key](value) };
}

const MIB = 2 ** 20;

test("what is under way is said in words, with its share", () => {
  const { tell } = status();
  const said = (stats) => {
    tell("stats", stats);
    return [parts.progress.textContent, parts.bar.style.transform];
  };
  assert.deepEqual(said({ progress: "complete", samples: 3, spp: 12 }), ["Converging 3 of 12", "scaleX(0.25)"]);
  assert.deepEqual(said({ progress: "preview", samples: 0, spp: 4 }), ["Preview 0 of 4", "scaleX(0)"]);
  assert.deepEqual(said({ progress: "done", samples: 12, spp: 12 }), ["Done", "scaleX(1)"]);
  assert.deepEqual(said({ progress: "screenshot", samples: 1, spp: 4 })[0], "Rendering a picture to save");
  // A picture that lacks damaged pages is never called done.
  assert.deepEqual(said({ progress: "damaged", samples: 12, spp: 12 })[0], "Damaged: not all of the model is shown");
  assert.deepEqual(said({ progress: "complete", samples: 9, spp: 4 })[1], "scaleX(1)");
  assert.deepEqual(said({ progress: "complete" }), ["Converging", "scaleX(0)"]);
});

test("what the server does not say is not shown", () => {
  const { tell } = status();
  tell("stats", { progress: "complete", fps: 29.6, memory: { used_bytes: 100 * MIB, limit_bytes: 256 * MIB } });
  assert.deepEqual([parts.memory.textContent, parts.rate.textContent], ["100 MiB of 256 MiB", "30/s"]);
  tell("stats", { progress: "complete", fps: 0.4 });
  assert.deepEqual([parts.memory.textContent, parts.rate.textContent], ["", ""]);
  tell("stats", { progress: "done", fps: 30 });
  assert.equal(parts.rate.textContent, "");
});

test("who drives is said where others are", () => {
  const { app, tell } = status({ role: "drive", clients: 1 });
  const role = () => {
    tell("role");
    return [parts.role.textContent, parts.drive.hidden, document.body.dataset.link];
  };
  assert.deepEqual(role(), ["", true, "driving"]);
  app.state.clients = 3;
  assert.deepEqual(role(), ["driving, 2 more here", true, "driving"]);
  app.state.role = "watch";
  assert.deepEqual(role(), ["watching, 2 more here", false, "watching"]);
  [app.link, app.connection.is_open] = ["reconnecting", false];
  assert.deepEqual(role(), ["lost, trying again", true, "reconnecting"]);
  app.link = "refused";
  assert.deepEqual(role()[0], "refused");
});

test("a picture that is smaller than the page says so", () => {
  const { tell } = status({ size: [400, 300], smaller: { asked: [800, 600], limit_bytes: 512 * MIB } });
  tell("size");
  assert.equal(parts.smaller.textContent, "400×300 of 800×600: 512 MiB would do");
});

test("damaged pages are counted", () => {
  const { app, tell } = status({ damage: { page_count: 1 } });
  tell("damage");
  assert.deepEqual([parts.damage.textContent, parts.damage.hidden], ["1 page of the file is damaged", false]);
  app.state.damage.page_count = 12;
  tell("damage");
  assert.equal(parts.damage.textContent, "12 pages of the file are damaged");
  app.state.damage = null;
  tell("damage");
  assert.equal(parts.damage.hidden, true);
});

test("a plot keeps its latest values", () => {
  const plot = new Plot("Memory");
  for (let value = 0; value < 130; value += 1) {
    plot.add(value, 200);
  }
  assert.equal(plot.values.length, 120);
  assert.deepEqual([plot.values[0], plot.values.at(-1), plot.limit], [10, 129, 200]);
  plot.add(NaN);
  assert.deepEqual([plot.values.at(-1), plot.limit], [0, null]);
});

/** A canvas that keeps the points of its lines. */
function canvas(lines) {
  const add = (x, y) => lines.at(-1).push([x, y]);
  const context = { scale() {}, stroke() {}, fill() {}, setLineDash() {}, beginPath: () => lines.push([]),
    lineTo: add, moveTo: add };
  return { isConnected: true, getContext: () => context };
}

test("the newest value of a plot is at its right edge, the greatest at its top, nothing at its bottom", () => {
  const plot = new Plot("Memory");
  const lines = [];
  globalThis.window = { devicePixelRatio: 1 };
  globalThis.getComputedStyle = () => ({ color: "red" });
  plot.canvas = canvas(lines);
  [0, 5, 10].forEach((value) => plot.add(value, 20));
  const [curve, limit] = lines.slice(-2);
  const [first, second, third] = curve;
  assert.deepEqual([third[0], first[1]], [131, 28]);
  // The limit is above all values here: 3 pixels below the edge. Half of it is in the middle.
  assert.deepEqual(limit, [[0, 3], [132, 3]]);
  assert.deepEqual([second[1], third[1]], [28 - 25 / 4, 28 - 25 / 2]);
  assert.ok(first[0] < second[0] && second[0] < third[0]);
});

test("a measure is the distance of two points of the surface", () => {
  const said = [];
  const app = { painters: [], paint() {} };
  const measure = new Measure(app, { say: (text) => said.push(text), refresh() {} });
  measure.tool_changed("measure");
  measure.point({ position: [1, 2, 3] });
  measure.point(null);
  measure.point({ position: [3, 5, 9] });
  assert.deepEqual(said, ["Click the first point", "Click the second point", "Nothing is there", "Distance 7"]);
  assert.deepEqual(measure.measures, [[[1, 2, 3], [3, 5, 9]]]);
  // Another tool forgets the first of two points.
  measure.point({ position: [0, 0, 0] });
  measure.tool_changed(null);
  assert.equal(measure.first, null);
  for (let at = 0; at < 120; at += 1) {
    measure.point({ position: [at, 0, 0] });
  }
  assert.equal(measure.measures.length, 50);
});

test("the cap of a section has no triangle and no page", () => {
  globalThis.document.createElement = () => ({ ...made(), append(...children) { this.children = children; } });
  const measure = new Measure({ painters: [], paint() {} }, { refresh() {} });
  const hit = { name: "steel", material: 3, position: [1, 2, 3], colour: [0, 0, 0], normal: [0, 0, 1],
    shading_normal: [0, 0, 1], distance: 2 };
  const texts = (ids) => measure.facts({ ...hit, ...ids }).children.flatMap((part) => part.children);
  const of_mesh = texts({ triangle: 0, page: 0 });
  assert.deepEqual([of_mesh[1], of_mesh.at(-1)], ["0", "0"]);
  const of_cap = texts({ triangle: null, page: null });
  assert.equal(of_cap[1], "none: the cap of a section");
  assert.ok(!of_cap.includes("Page") && of_cap.includes("Distance"), of_cap.join());
});

test("of many calls within a frame the last is done", () => {
  const [frames, done] = [[], []];
  globalThis.requestAnimationFrame = (call) => frames.push(call);
  const call = once_a_frame((value) => done.push(value));
  [1, 2, 3].forEach((value) => call(value));
  assert.deepEqual([frames.length, done], [1, []]);
  frames[0]();
  call(4);
  frames[1]();
  assert.deepEqual(done, [3, 4]);
});
