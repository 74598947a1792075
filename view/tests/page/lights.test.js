// Lights and their handles: what arrives at the target is worked out by the law of each kind, not by the page's own.

import assert from "node:assert/strict";
import { test } from "node:test";
import { page } from "./page.js";

const { Handles } = await page("handles");
const { Lights } = await page("lights");
const { project } = await page("camera");

const CAMERA = { position: [0, 0, 10], target: [0, 0, 2], up: [0, 1, 0], fov_y: 40 };
const SIZE = [800, 400];
const POINT = { type: "point", position: [3, 4, 2], intensity: [1, 2, 4] };
const RECT = { type: "rect", corner: [1, 1, 1], edge_u: [2, 0, 0], edge_v: [0, 0, 4], radiance: [1, 1, 1] };
const SUN = { type: "directional", direction: [0, -5, 0], irradiance: [2, 2, 2] };
const SKY = { type: "sky", radiance: [0.2, 0.2, 0.2] };

const near = (a, b) => a.forEach((part, at) => assert.ok(Math.abs(part - b[at]) < 1e-9, `${a} is not ${b}`));

/** The lights of a page with the camera above, and what was said and sent. */
function lights(list, { may_edit = true } = {}) {
  const [said, sent] = [[], []];
  globalThis.requestAnimationFrame = (call) => call();
  globalThis.document = { body: { classList: { toggle() {} } } };
  const app = { camera: CAMERA, extent: 5, painters: [], state: { lights: list, bounds: {} }, paint() {},
    may_edit: () => may_edit, set_lights: (given) => may_edit && sent.push(given),
    wish_lights: (given) => { app.state.lights = given; },
    connection: { send: (message) => sent.push(message) },
    panels: { refresh() {}, rebuild() {}, say: (text) => said.push(text) } };
  const handles = new Handles(app);
  return { app, handles, made: new Lights(app, handles), said, sent };
}

test("a handle stands at the light, and puts it where it is moved to", () => {
  const { handles } = lights([]);
  assert.deepEqual(handles.point(POINT), [3, 4, 2]);
  assert.deepEqual(handles.point(RECT), [2, 1, 3]);
  assert.equal(handles.point(SKY), null);
  // A sun that shines down has its handle above the target.
  const [x, y, z] = handles.point(SUN);
  near([x, z], [0, 2]);
  assert.ok(y > 0);
  assert.deepEqual(handles.with_point(POINT, [7, 8, 9]), { ...POINT, position: [7, 8, 9] });
  assert.deepEqual(handles.with_point(RECT, [3, 1, 3]), { ...RECT, corner: [2, 1, 1] });
  near(handles.with_point(SUN, [6, 0, 10]).direction, [-0.6, 0, -0.8]);
  assert.deepEqual(handles.with_point(SUN, CAMERA.target), SUN, "at the target itself there is no direction");
});

test("the handle of a sun is in the picture, and stays on its ball", () => {
  const { app, handles } = lights([SUN]);
  for (const direction of [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [1, 2, -3], [0, 0, 1]]) {
    const sun = { ...SUN, direction };
    const place = project(CAMERA, SIZE, handles.point(sun));
    assert.ok(place.depth > 0 && place.x > 0 && place.x < 800 && place.y > 0 && place.y < 400, `${direction}`);
    const moved = handles.moved(sun, handles.point(sun), [0.3, -0.2, 0.1]);
    const far = ([x, y, z]) => Math.hypot(x, y, z - 2);
    near([far(handles.point(moved))], [far(handles.point(sun))]);
    near([Math.hypot(...moved.direction)], [1]);
  }
  // A wide view would have a ball that reaches behind the camera.
  app.camera = { ...CAMERA, fov_y: 150 };
  assert.ok(project(app.camera, SIZE, handles.point({ ...SUN, direction: [0, 0, -1] })).depth > 0);
});

test("a light outside of the picture has its handle at the edge, one behind has none", () => {
  const at = (position) => ({ ...POINT, position });
  const { handles } = lights([at([0, 0, 2]), at([100, 0, 2]), at([0, 0, 30]), SKY]);
  const place = (point) => project(CAMERA, SIZE, point);
  assert.deepEqual(handles.placed(place, SIZE), [], "none while they are off");
  handles.toggle(true);
  const [middle, right, ...others] = handles.placed(place, SIZE);
  assert.deepEqual([middle.at, middle.x, middle.y, middle.missing], [0, 400, 200, [0, 0]]);
  assert.deepEqual([right.at, right.x, right.y], [1, 786, 200]);
  near(right.missing, [786 - place([100, 0, 2]).x, 0]);
  assert.deepEqual(others, []);
});

test("what a hand grabs follows it", () => {
  const { app, handles, sent } = lights([SKY, { ...POINT, position: [0, 0, 2] }]);
  handles.toggle(true);
  handles.last = handles.placed((point) => project(CAMERA, SIZE, point), SIZE);
  assert.equal(handles.grab({ x: 417, y: 200 }), null, "too far off");
  const grabbed = handles.grab({ x: 410, y: 195 });
  grabbed.drag(30, -20, SIZE);
  const { x, y, depth } = project(CAMERA, SIZE, app.state.lights[1].position);
  near([x, y, depth], [430, 180, 8]);
  assert.deepEqual(sent, [app.state.lights]);
  assert.equal(handles.selected, 1);
  grabbed.drop();
  assert.deepEqual(sent.at(-1), { type: "rest" });
  handles.toggle(false);
  assert.equal(handles.grab({ x: 430, y: 180 }), null, "none while they are off");
});

test("a light from outside of the picture comes to the hand first", () => {
  const { app, handles } = lights([{ ...POINT, position: [0, 100, 2] }]);
  handles.toggle(true);
  handles.last = handles.placed((point) => project(CAMERA, SIZE, point), SIZE);
  const grabbed = handles.grab({ x: 400, y: 14 });
  for (const y of [34, 54]) {
    grabbed.drag(5, 20, SIZE);
    near([project(CAMERA, SIZE, app.state.lights[0].position).y], [y]);
  }
});

/** What light of a kind brings to the target, W/m^2, of the strongest colour. */
const arriving = {
  point: ({ position: [x, y, z], intensity }) => Math.max(...intensity) / (x ** 2 + y ** 2 + (z - 2) ** 2),
  directional: ({ irradiance }) => Math.max(...irradiance),
  // A small rectangle that faces the target: radiance times solid angle.
  rect: ({ corner, edge_u, edge_v, radiance }) => {
    const middle = corner.map((part, at) => part + (edge_u[at] + edge_v[at]) / 2);
    const side = (edge) => Math.sqrt(edge.reduce((sum, part) => sum + part * part, 0));
    const far = Math.hypot(middle[0], middle[1], middle[2] - 2);
    return (Math.max(...radiance) * side(edge_u) * side(edge_v)) / far ** 2;
  },
  sky: ({ radiance }) => Math.max(...radiance) * 2 * Math.PI,
};
const COLOURS = { point: "intensity", directional: "irradiance", rect: "radiance", sky: "radiance" };

test("a light of any kind brings what was asked for, in its colour", () => {
  const { made, handles } = lights([]);
  for (const kind of Object.keys(arriving)) {
    for (const irradiance of [1, 0.02, 300]) {
      const light = made.made(kind, [3, -4, 14], [1, 0.5, 0.25], irradiance);
      assert.equal(light.type, kind);
      near([arriving[kind](light) / irradiance], [1]);
      const colour = light[COLOURS[kind]];
      near(colour.map((part) => part / colour[0]), [1, 0.5, 0.25]);
      // So that a change of kind keeps it.
      near([made.arrives(light) / irradiance], [1]);
      if (kind === "point" || kind === "rect") {
        near(handles.point(light), [3, -4, 14]);
      }
    }
  }
  near(made.made("directional", [3, -4, 14], [1, 1, 1]).direction, [-3 / 13, 4 / 13, -12 / 13]);
});

test("an area light is a square that shines at the target", () => {
  const { made } = lights([]);
  const { edge_u: [a, b, c], edge_v: [d, e, f] } = made.made("rect", [3, -4, 14], [1, 1, 1]);
  // Its normal is edge_u x edge_v.
  const normal = [b * f - c * e, c * d - a * f, a * e - b * d];
  const size = Math.hypot(...normal);
  near(normal.map((part) => part / size), [-3 / 13, 4 / 13, -12 / 13]);
  near([a * d + b * e + c * f, Math.hypot(a, b, c) - Math.hypot(d, e, f)], [0, 0]);
});

test("a new light stands over the shoulder of who looks", () => {
  const [x, y, z] = lights([]).made.new_place;
  // To the right, above, and on the side of the camera.
  assert.ok(x > 0 && y > 0 && z > 2, `${[x, y, z]}`);
  near([Math.hypot(x, y, z - 2)], [0.8 * 8]);
});

test("a light that brings nothing counts as a new one", () => {
  const { made } = lights([]);
  assert.equal(made.arrives({ ...POINT, intensity: [0, 0, 0] }), 1);
  assert.equal(made.arrives({ ...POINT, position: CAMERA.target }), 1);
});

/** A page that only watches said that all lamps were stronger, and none was. */
test("lamps that stay as they are are not said to be stronger", () => {
  const driving = lights([POINT, SKY]);
  driving.made.stronger(2);
  assert.deepEqual(driving.sent, [[{ ...POINT, intensity: [2, 4, 8] }, { ...SKY, radiance: [0.4, 0.4, 0.4] }]]);
  assert.deepEqual(driving.said, ["All lamps stronger"]);
  const watching = lights([POINT, SKY], { may_edit: false });
  watching.made.stronger(2);
  assert.deepEqual([watching.said, watching.sent], [[], []]);
});
