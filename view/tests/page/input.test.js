// The hand, over an application that keeps what it is asked to do.

import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { page } from "./page.js";

const { Input } = await page("input");

const CAMERA = { position: [0, 0, 5], target: [0, 0, 0], up: [0, 1, 0], fov_y: 40 };
const KEY = { target: {}, ctrlKey: false, metaKey: false, shiftKey: false, altKey: false, preventDefault() {} };
const BUTTON = { pointerId: 1, button: 0, ctrlKey: false, metaKey: false, shiftKey: false };

let frames;
let selection;
beforeEach(() => {
  [frames, selection] = [[], ""];
  globalThis.window = { addEventListener() {}, getSelection: () => selection };
  globalThis.requestAnimationFrame = (call) => frames.push(call);
});

/** Runs the animation frames that wait. */
const animate = (now) => frames.splice(0).forEach((call) => call(now));

function input() {
  const done = [];
  const stage = { addEventListener() {}, focus() {}, setPointerCapture() {}, clientWidth: 800, clientHeight: 400,
    getBoundingClientRect: () => ({ left: 10, top: 20, width: 800, height: 400 }) };
  const app = { stage, extent: 4, camera: CAMERA, box: () => ({ left: 0, top: 0, width: 800, height: 400 }),
    rest: () => done.push("rest"),
    move: (camera) => {
      app.camera = camera;
      done.push("move");
    },
    panels: { tool: null, grab: () => null, hover() {}, clicked: (x, y) => done.push(`click ${x} ${y}`),
      act: (name) => done.push(name) > 0, say() {} } };
  return { app, done, made: new Input(app) };
}

test("a drag moves the view and ends with a rest", () => {
  for (const [how, is_moved] of [[{}, "position"], [{ shiftKey: true }, "target"], [{ button: 2 }, "target"]]) {
    const { app, done, made } = input();
    made.down({ ...BUTTON, ...how, clientX: 100, clientY: 100 });
    made.moved({ ...BUTTON, clientX: 130, clientY: 90 });
    assert.equal(made.is_busy, true);
    made.up({ ...BUTTON, clientX: 130, clientY: 90 });
    assert.deepEqual(done, ["move", "rest"]);
    assert.equal(made.is_busy, false);
    assert.notDeepEqual(app.camera[is_moved], CAMERA[is_moved]);
    // To turn leaves the target where it is.
    assert.equal(app.camera.target[0] === 0, is_moved === "position");
  }
});

test("two fingers twice as far apart come nearer by half", () => {
  const { app, made } = input();
  const finger = (pointerId, clientX) => ({ ...BUTTON, pointerId, clientX, clientY: 220 });
  made.down(finger(1, 370));
  made.down(finger(2, 450));
  made.moved(finger(1, 330));
  made.moved(finger(2, 490));
  assert.ok(Math.abs(app.camera.position[2] - app.camera.target[2] - 2.5) < 1e-12);
  // The middle of both has stayed, and so has what is seen there.
  assert.ok(Math.abs(app.camera.target[0]) < 1e-12);
});

test("a click with a tool, or with Ctrl, picks where the stage has it", () => {
  const { done, made, app } = input();
  made.down({ ...BUTTON, ctrlKey: true, clientX: 110, clientY: 120 });
  made.up({ ...BUTTON, clientX: 110, clientY: 120 });
  app.panels.tool = "measure";
  made.down({ ...BUTTON, clientX: 60, clientY: 40 });
  made.up({ ...BUTTON, clientX: 61, clientY: 40 });
  assert.deepEqual(done, ["click 100 100", "click 51 20"]);
});

/** A finger that the browser took away, for a gesture of its own, counted as a click. */
test("a pointer that is cancelled picks nothing", () => {
  const { done, made } = input();
  made.down({ ...BUTTON, ctrlKey: true, clientX: 110, clientY: 120 });
  made.up({ ...BUTTON, type: "pointercancel", clientX: 110, clientY: 120 });
  assert.deepEqual(done, []);
  assert.equal(made.is_busy, false);
});

test("a key that is held flies, as fast as the clock says", () => {
  const { app, done, made } = input();
  const begin = performance.now();
  made.key_down({ ...KEY, key: "w", code: "KeyW" });
  animate(begin + 1000);
  const first = app.camera.position[2];
  // A tenth of a second at most a frame; a quarter of the extent a second.
  assert.ok(Math.abs(first - (5 - 0.1)) < 1e-9, `${first}`);
  animate(begin + 1050);
  assert.ok(Math.abs(app.camera.position[2] - (first - 0.05)) < 1e-9);
  assert.ok(Math.abs(app.camera.target[2] + 0.15) < 1e-9);
  made.key_up({ code: "KeyW" });
  animate(begin + 1100);
  assert.deepEqual(done, ["move", "move", "rest"]);
  assert.equal(frames.length, 0);
});

/** Each press within one frame of the last began a flight of its own beside it: the view flew twice as fast. */
test("a key that is let go and pressed again within a frame flies once", () => {
  const { done, made } = input();
  for (let press = 0; press < 3; press += 1) {
    made.key_down({ ...KEY, key: "w", code: "KeyW" });
    made.key_up({ code: "KeyW" });
  }
  made.key_down({ ...KEY, key: "w", code: "KeyW" });
  done.length = 0;
  animate(performance.now() + 16);
  animate(performance.now() + 32);
  assert.deepEqual(done, ["move", "move"]);
});

/** With Cmd, a Mac's Ctrl, the link to the view took the place of the text that was selected. */
test("text that is selected is what is copied", () => {
  for (const held of [{ ctrlKey: true }, { metaKey: true }]) {
    const { done, made } = input();
    selection = "some words of a panel";
    made.key_down({ ...KEY, ...held, key: "c", code: "KeyC" });
    assert.deepEqual(done, []);
    selection = "";
    made.key_down({ ...KEY, ...held, key: "c", code: "KeyC" });
    assert.deepEqual(done, ["copy_link"]);
  }
});

test("keys in a field are the field's", () => {
  const { done, made } = input();
  const field = (tagName) => ({ closest: () => ({ tagName }) });
  made.key_down({ ...KEY, target: field("INPUT"), key: "p", code: "KeyP" });
  made.key_down({ ...KEY, target: field("BUTTON"), key: "Enter", code: "Enter" });
  assert.deepEqual(done, []);
  made.key_down({ ...KEY, target: field("BUTTON"), key: "p", code: "KeyP" });
  made.key_down({ ...KEY, target: field("INPUT"), key: "Escape", code: "Escape" });
  assert.deepEqual(done, ["pick", "escape"]);
});
