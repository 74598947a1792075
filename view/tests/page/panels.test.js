// What panels decide, without what they show: the next debug view, the list of materials, rates, names of files.

import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { page } from "./page.js";

const { Export } = await page("export");
const { Materials } = await page("materials");
const { Settings } = await page("settings");
const { Statistics } = await page("statistics");

let links;
beforeEach(() => {
  links = [];
  const made = () => ({ setAttribute(key, value) { this[key] = value; }, append() {}, addEventListener() {},
    click() { links.push(this.download); } });
  globalThis.document = { getElementById: () => ({ hidden: true }), createElement: made, activeElement: null };
  globalThis.requestAnimationFrame = (call) => queueMicrotask(call);
});

/** An application that keeps what it is asked to send, and its panels. */
function application(state) {
  const [sent, said, listeners] = [[], [], {}];
  let ids = 0;
  const panels = { say: (text) => said.push(text), refresh() {}, rebuild() {} };
  const app = { state, panels, drives: true, listen: (key, call) => { listeners[key] = call; }, tell() {},
    may_edit: () => true, edit: (message) => sent.push(message), next_id: () => (ids += 1),
    key: () => ({ choices: [] }),
    connection: { send: (message) => sent.push(message) > 0 }, picture: { drop_under() {}, keep_under() {} } };
  return { app, panels, sent, said, listeners };
}

test("the debug key goes through the debug views and back to the method before", () => {
  const { app } = application({ settings: { integrator: "path" } });
  app.set_settings = (values) => Object.assign(app.state.settings, values);
  const settings = new Settings(app);
  const names = [1, 2, 3, 4].map(() => {
    settings.next_debug();
    return app.state.settings.integrator;
  });
  assert.deepEqual(names, ["debug-upper", "debug-pages", "path", "debug-upper"]);
});

const named = (index, kd = [1, 1, 1]) => ({ index, name: `m${index}`, kd });

test("the list of materials is the answer to the last question", () => {
  const { app, panels, sent, listeners } = application({});
  const materials = new Materials(app, panels);
  materials.search = "m";
  materials.ask({ from: 24 });
  materials.select(7);
  assert.deepEqual(sent, [{ type: "materials", id: 1, find: "m", from: 24 }, { type: "materials", id: 2, index: 7 }]);
  listeners.materials({ id: 1, from: 24, found: 30, items: [named(24)] });
  assert.equal(materials.chosen, null, "an answer to an older one");
  listeners.materials({ id: 2, from: 0, found: 30, items: [named(6), named(7), named(8)] });
  assert.equal(materials.chosen.index, 7);
  // What is chosen stays, where a search does not find it.
  materials.ask({ from: 0 });
  listeners.materials({ id: 3, from: 0, found: 1, items: [named(2)] });
  assert.equal(materials.chosen.index, 7);
  listeners.material(named(7, [0, 1, 0]));
  assert.deepEqual(materials.chosen.kd, [0, 1, 0]);
});

test("an edit of a material sends the keys that changed, once a frame", async () => {
  const { app, panels, sent } = application({});
  const [materials, material] = [new Materials(app, panels), named(3)];
  materials.change(material, { kd: [0.1, 0, 0] });
  materials.change(material, { kd: [0.2, 0, 0] });
  materials.change(material, { ns: 50 });
  await null;
  assert.deepEqual(sent, [{ type: "material", index: 3, edit: { kd: [0.2, 0, 0], ns: 50 } }]);
  assert.deepEqual([material.kd, material.ns], [[0.2, 0, 0], 50]);
});

test("misses of pages are counted by the second", () => {
  const { app } = application({});
  const statistics = new Statistics(app);
  const rate = (now, misses) => {
    performance.now = () => now;
    const stats = { pool: { misses } };
    statistics.take(stats);
    return stats.misses_per_s;
  };
  assert.equal(rate(1000, 500), undefined, "there is nothing before");
  assert.equal(rate(1500, 600), 200);
  assert.equal(rate(3500, 604), 2);
  assert.equal(rate(4500, 10), 0, "a new session begins to count anew");
  assert.deepEqual(statistics.plots.get("misses").values, [200, 2, 0]);
  delete performance.now;
});

test("a picture that was asked for is saved under the model's name", () => {
  const { app, sent } = application({ name: "Grüße / room.v2.trex", size: [4, 3], settings: { spp: 8 } });
  const panel = new Export(app);
  const file = (format, id) => Uint8Array.from([3, format, 0, 0, id, 0, 0, 0, 1, 2, 3]).buffer;
  globalThis.setTimeout = () => {};
  panel.received(file(0, 1));
  assert.deepEqual(links, [], "nobody asked");
  app.may_edit = () => false;
  panel.quick();
  assert.deepEqual([panel.under_way, sent], [null, []], "who watches asks for none");
  app.may_edit = () => true;
  panel.take("exr", [4, 3], 2);
  panel.quick();
  assert.deepEqual(sent, [{ type: "screenshot", id: 1, format: "exr", size: [4, 3], spp: 2 }], "one at a time");
  panel.received(file(1, 9));
  panel.received(file(1, 1));
  assert.equal(panel.under_way, null);
  panel.received(file(2, 5));
  assert.deepEqual(links, ["Gr-e-room.v2.exr", "Gr-e-room.v2.toml"]);
});
