// Keys, as browsers tell of them: an event's `key` has Shift and Caps Lock in it, its `code` has the place alone.

import assert from "node:assert/strict";
import { test } from "node:test";
import { anything, page } from "./page.js";

const { FLIGHT, KEYS, action_of } = await page("keys");

const NONE = { ctrlKey: false, metaKey: false, shiftKey: false, altKey: false };
const event = (key, held = {}) => ({ ...NONE, key, ...held });
const shift = { shiftKey: true };
const control = { ctrlKey: true };
const command = { metaKey: true };

const ROWS = KEYS.flatMap(([, rows]) => rows);

test("a key does what the help says", () => {
  for (const [pressed, action] of [
    [event("r"), "reset"], [event("Enter"), "reset"], [event("Home"), "reset"],
    [event("Backspace"), "undo"], [event("z", control), "undo"], [event("z", command), "undo"],
    [event("Backspace", shift), "redo"], [event("Z", { ...control, ...shift }), "redo"], [event("y", control), "redo"],
    [event("z"), "statistics"], [event("l"), "brighter"], [event("L", shift), "darker"],
    [event("S", shift), "screenshot"], [event("F12"), "screenshot"], [event("c"), "next_camera"],
    [event("c", control), "copy_link"], [event("c", command), "copy_link"],
    // Where these are on the keyboard, and whether Shift is held for them, is the layout's.
    [event("?", shift), "help"], [event("?"), "help"], [event("+", shift), "nearer"], [event("="), "nearer"],
    [event("7", shift), "top"],
  ]) {
    assert.equal(action_of(pressed), action, JSON.stringify(pressed));
  }
});

test("other keys do nothing", () => {
  for (const pressed of [event("x"), event("r", control), event("R", shift), event("Enter", shift),
    event("r", { altKey: true }), event("c", { ...control, altKey: true }), event("C", { ...control, ...shift }),
    event("Shift", shift), event("Control", control), event("Dead"), event("F1"), event(" ")]) {
    assert.equal(action_of(pressed), undefined, JSON.stringify(pressed));
  }
});

/** Caps Lock turned letters over: "Z" undid nothing, and Shift made lamps stronger. So does Cmd with Shift on a Mac. */
test("Shift says which letter is meant, not its case", () => {
  for (const [pressed, action] of [
    [event("R"), "reset"], [event("Z", control), "undo"], [event("C", command), "copy_link"],
    [event("l", shift), "darker"], [event("s", shift), "screenshot"],
    [event("z", { ...command, ...shift }), "redo"], [event("z", { ...control, ...shift }), "redo"],
  ]) {
    assert.equal(action_of(pressed), action, JSON.stringify(pressed));
  }
});

test("every key of the table does what it stands beside, and no key stands twice", () => {
  const seen = new Set();
  for (const [keys, text, action] of ROWS) {
    assert.ok(text.length > 0 && keys.length > 0);
    for (const name of keys) {
      assert.ok(!seen.has(name), `${name} stands twice`);
      seen.add(name);
      const key = name.replace(/^Ctrl\+/, "").replace(/^Shift\+/, "");
      const held = { ctrlKey: name.startsWith("Ctrl+"), shiftKey: name.includes("Shift+") };
      assert.equal(action_of(event(key, held)), action, name);
    }
  }
  // Keys that fly are none of the table, or these would never be done.
  for (const code of Object.keys(FLIGHT)) {
    assert.ok(!seen.has(code.at(-1).toLowerCase()), code);
  }
});

test("the ways to fly are six, each with its opposite", () => {
  const ways = Object.values(FLIGHT);
  assert.deepEqual(FLIGHT.KeyW, [0, 0, 1]);
  assert.deepEqual(FLIGHT.KeyA, [-1, 0, 0]);
  assert.deepEqual(FLIGHT.KeyE, [0, 1, 0]);
  assert.equal(new Set(ways.map(String)).size, 6);
  for (const way of ways) {
    assert.ok(ways.some((other) => other.every((part, axis) => part + way[axis] === 0)), `${way}`);
  }
});

test("the view or the panels do every action of the table", async () => {
  const [{ Input }, { Panels }] = [await page("input"), await page("panels")];
  globalThis.document = anything();
  for (const [, , action] of ROWS) {
    const panels = { act: (name, at) => Panels.prototype.act.call(anything(), name, at) };
    const app = { camera: { position: [0, 0, 1], target: [0, 0, 0], up: [0, 1, 0], fov_y: 40 }, panels,
      stage: anything(), views: anything(), jump() {}, rest() {} };
    const input = { app, at: [0, 0], in_picture: () => ({ size: [4, 3] }), zoom_by() {}, focus() {} };
    assert.equal(Input.prototype.act.call(input, action), true, action);
  }
  assert.equal(Panels.prototype.act.call(anything(), "nothing of this name", [0, 0]), false);
});

test("the help names keys as keyboards do", async () => {
  const { name_of } = await page("help");
  for (const [key, cap] of [["r", "R"], ["ArrowLeft", "←"], ["Ctrl+Shift+Z", "Ctrl + Shift + Z"], ["+", "+"],
    ["Escape", "Esc"], ["F12", "F12"], ["Ctrl+c", "Ctrl + C"]]) {
    assert.equal(name_of(key), cap);
  }
});
