// The camera, beside a pinhole whose axes come from angles: a matrix turns the axes of the world into the camera's, so
// that no cross product of the page's own is taken on trust; turns are held against azimuth and elevation.

import assert from "node:assert/strict";
import { test } from "node:test";
import { page, random } from "./page.js";

const camera_of = await page("camera");
const { orbit, look, pan, zoom, roll, fly, project, numbered, from_text, to_text, is_camera, same } = camera_of;

const SIZE = [800, 500];
const RADIANS = Math.PI / 180;

const close = (a, b, within = 1e-9) => {
  const [left, right] = [[a].flat(), [b].flat()];
  assert.equal(left.length, right.length);
  left.forEach((number, at) => {
    const allowed = within * Math.max(1, Math.abs(right[at]));
    assert.ok(Math.abs(number - right[at]) <= allowed, `${JSON.stringify(a)} is not ${JSON.stringify(b)}`);
  });
};

const plus = (a, b, factor = 1) => a.map((part, at) => part + factor * b[at]);
const apart = (a, b) => Math.sqrt(a.reduce((sum, part, at) => sum + (part - b[at]) ** 2, 0));

/** Columns of Rz(c) Ry(b) Rx(a): where the axes of the world go. */
function axes(a, b, c) {
  const [sa, ca, sb, cb, sc, cc] = [a, b, c].flatMap((angle) => [Math.sin(angle), Math.cos(angle)]);
  return [
    [cc * cb, sc * cb, -sb],
    [cc * sb * sa - sc * ca, sc * sb * sa + cc * ca, cb * sa],
    [cc * sb * ca + sc * sa, sc * sb * ca - cc * sa, cb * ca],
  ];
}

/** A camera whose picture has the axes `right`, `up` and `back`. Its own up leans, as those of people do. */
function posed(seed) {
  const [a, b, c, x, y, z, far, angle, lean] = random(seed, 9);
  const [right, up, back] = axes(6 * a, 6 * b, 6 * c);
  const position = [20 * x - 10, 20 * y - 10, 20 * z - 10];
  const distance = 0.1 + 9 * far;
  const target = plus(position, back, -distance);
  const camera = { position, target, up: plus(up, back, 2 * lean - 1), fov_y: 10 + 100 * angle };
  return { camera, right, up, back, distance, half: Math.tan((camera.fov_y / 2) * RADIANS) };
}

/** The point of the world that the pixel x, y sees at `depth`. */
function unprojected({ camera, right, up, back, half }, [width, height], x, y, depth) {
  const sideways = ((x - width / 2) / (height / 2)) * half * depth;
  const upwards = ((height / 2 - y) / (height / 2)) * half * depth;
  return plus(plus(plus(camera.position, right, sideways), up, upwards), back, -depth);
}

/** Distance, and angles about y, of the way from `from` to `to`: azimuth from +z towards +x, elevation. */
function angles(from, to) {
  const [x, y, z] = plus(to, from, -1);
  return { far: Math.hypot(x, y, z), azimuth: Math.atan2(x, z), elevation: Math.atan2(y, Math.hypot(x, z)) };
}

/** An angle in (-pi, pi]. */
const turned = (angle) => Math.atan2(Math.sin(angle), Math.cos(angle));

const SEEDS = Array.from({ length: 40 }, (_, seed) => seed + 1);
/** Cameras with y up that look along no axis. */
const LEVEL = SEEDS.map((seed) => {
  const [x, y, z, far, azimuth, elevation, angle] = random(seed, 7);
  const target = [x, y, z];
  const [around, above, distance] = [6.28 * azimuth, 2.4 * elevation - 1.2, 0.5 + 4 * far];
  const way = [Math.sin(around) * Math.cos(above), Math.sin(above), Math.cos(around) * Math.cos(above)];
  return { position: plus(target, way, distance), target, up: [0, 3, 0], fov_y: 20 + 60 * angle };
});

test("a point is projected to the pixel that sees it", () => {
  for (const seed of SEEDS) {
    const pose = posed(seed);
    for (const [x, y, depth] of [[0, 0, 1], [400, 250, 0.01], [799, 10, 30], [-50, 700, 5]]) {
      const place = project(pose.camera, SIZE, unprojected(pose, SIZE, x, y, depth));
      close([place.x, place.y], [x, y], 1e-8);
      close(place.depth, depth);
    }
    assert.ok(project(pose.camera, SIZE, plus(pose.camera.position, pose.back, 2)).depth < 0, "behind");
  }
});

test("the frame is that of the pinhole", () => {
  for (const seed of SEEDS) {
    const { camera, right, up, back } = posed(seed);
    const found = camera_of.frame(camera);
    close(found.right, right);
    close(found.up, up);
    close(found.forward, back.map((part) => -part));
  }
  // Along up there is no right side: any will do, but there is one.
  const straight = { position: [0, 5, 0], target: [0, 0, 0], up: [0, 1, 0], fov_y: 40 };
  const { right, up, forward } = camera_of.frame(straight);
  close([right, up, forward].map((axis) => Math.hypot(...axis)), [1, 1, 1]);
  close(forward, [0, -1, 0]);
});

test("a drag turns about the target as far as the hand goes, and the model follows", () => {
  for (const camera of LEVEL) {
    const before = angles(camera.target, camera.position);
    for (const [dx, dy] of [[30, 0], [0, 10], [-77, -12], [5, 8]]) {
      const after = orbit(camera, SIZE[1], dx, dy);
      const now = angles(after.target, after.position);
      assert.deepEqual(after.target, camera.target);
      close(now.far, before.far);
      // Half a turn a height. The camera goes left where the hand goes right, and up where the hand goes down.
      close(turned(now.azimuth - before.azimuth), (-dx / SIZE[1]) * Math.PI);
      close(now.elevation, before.elevation + (dy / SIZE[1]) * Math.PI);
      const middle = project(after, SIZE, camera.target);
      close([middle.x, middle.y], [SIZE[0] / 2, SIZE[1] / 2], 1e-8);
    }
    // A point on the near side goes where the hand goes.
    const near = plus(camera.target, plus(camera.position, camera.target, -1), 0.2);
    const shown = project(orbit(camera, SIZE[1], 9, 6), SIZE, near);
    assert.ok(shown.x > SIZE[0] / 2 && shown.y > SIZE[1] / 2, JSON.stringify(shown));
  }
});

test("no drag turns over a pole", () => {
  for (const camera of LEVEL) {
    for (const dy of [-1e6, -600, 600, 1e6]) {
      for (const [turn, from, to] of [[orbit, "target", "position"], [look, "position", "target"]]) {
        const after = turn(camera, 500, 3, turn === orbit ? dy : dy * 10);
        const { elevation } = angles(after[from], after[to]);
        close(Math.abs(elevation), Math.PI / 2 - 0.002, 1e-7);
        // Looking around, what is seen follows the hand: a hand that goes down brings the sky.
        assert.equal(Math.sign(elevation), Math.sign(dy));
        // And back again from there.
        const back = turn(after, 500, 0, -Math.sign(dy) * 20);
        assert.ok(Math.abs(angles(back[from], back[to]).elevation) < Math.PI / 2 - 0.01);
      }
    }
  }
});

test("looking around keeps the place and turns by the angle of view a height", () => {
  for (const camera of LEVEL) {
    const before = angles(camera.position, camera.target);
    for (const [dx, dy] of [[40, 0], [0, 25], [-13, -31]]) {
      const after = look(camera, SIZE[1], dx, dy);
      const now = angles(after.position, after.target);
      const per_pixel = (camera.fov_y * RADIANS) / SIZE[1];
      assert.deepEqual(after.position, camera.position);
      close(now.far, before.far);
      close(turned(now.azimuth - before.azimuth), dx * per_pixel);
      close(now.elevation, before.elevation + dy * per_pixel);
    }
    const shown = project(look(camera, SIZE[1], 20, 15), SIZE, camera.target);
    assert.ok(shown.x > SIZE[0] / 2 && shown.y > SIZE[1] / 2, JSON.stringify(shown));
  }
});

test("a pan takes what lies at the target's depth along with the hand", () => {
  for (const seed of SEEDS) {
    const pose = posed(seed);
    const after = pan(pose.camera, SIZE, 120, -45);
    const moved = { ...pose, camera: after };
    for (const [x, y] of [[0, 0], [400, 250], [700, 90]]) {
      const before = unprojected(pose, SIZE, x, y, pose.distance);
      close(before, unprojected(moved, SIZE, x + 120, y - 45, pose.distance), 1e-8);
    }
    // By the picture's width, the target moves by the width of what a pinhole sees at its depth.
    const width = (2 * pose.half * pose.distance * SIZE[0]) / SIZE[1];
    close(apart(pan(pose.camera, SIZE, SIZE[0], 0).target, pose.camera.target), width);
    const back = pan(after, SIZE, -120, 45);
    close(back.position, pose.camera.position);
    close(back.target, pose.camera.target);
  }
});

test("a zoom keeps what the pointer is on, and comes back", () => {
  for (const seed of SEEDS) {
    const pose = posed(seed);
    for (const [factor, x, y] of [[0.5, 400, 250], [0.8, 10, 480], [1.7, 650, 33]]) {
      const after = zoom(pose.camera, SIZE, 10, factor, x, y);
      const distance = apart(after.position, after.target);
      close(distance, pose.distance * factor);
      const fixed = unprojected(pose, SIZE, x, y, pose.distance);
      close(unprojected({ ...pose, camera: after }, SIZE, x, y, distance), fixed, 1e-8);
      const back = zoom(after, SIZE, 10, 1 / factor, x, y);
      close(back.position, pose.camera.position);
      close(back.target, pose.camera.target);
    }
  }
});

test("the distance to the target has bounds", () => {
  const camera = { position: [0, 0, 5], target: [0, 0, 0], up: [0, 1, 0], fov_y: 40 };
  const distance = (factor) => {
    const { position, target } = zoom(camera, SIZE, 2, factor, 400, 250);
    return apart(position, target);
  };
  close(distance(1e-30) * 1e9, 2);
  close(distance(1e30), 2e9);
});

test("a roll turns the picture about its middle", () => {
  for (const seed of SEEDS) {
    const pose = posed(seed);
    const above = unprojected(pose, SIZE, 400, 150, 3);
    const quarter = roll(pose.camera, Math.PI / 2);
    const left = project(quarter, SIZE, above);
    close([left.x, left.y], [300, 250], 1e-8);
    assert.deepEqual([quarter.position, quarter.target], [pose.camera.position, pose.camera.target]);
    const back = project(roll(quarter, -Math.PI / 2), SIZE, above);
    close([back.x, back.y], [400, 150], 1e-8);
  }
});

test("who flies takes the target along", () => {
  const camera = { position: [1, 2, 3], target: [1, 2, -7], up: [0, 2, 0], fov_y: 40 };
  const after = fly(camera, [1, 10, 100]);
  close(after.position, [2, 12, -97]);
  close(after.target, [2, 12, -107]);
  close(apart(after.position, after.target), 10);
});

const BOX = { lo: [-1, -2, 0], hi: [3, 2, 7] };

test("the numbered views look along the axes of the ground", () => {
  const camera = { position: [9, 9, 9], target: [0, 0, 0], up: [0, 1, 0], fov_y: 30 };
  const s = Math.sqrt(1 / 3);
  const way = (name, up) => {
    const { position, target } = numbered(name, camera, BOX, up, 1.6);
    const far = apart(position, target);
    return plus(target, position, -1).map((part) => part / far);
  };
  close(way("front", [0, 1, 0]), [0, 0, -1]);
  close(way("right", [0, 1, 0]), [-1, 0, 0]);
  close(way("isometric", [0, 1, 0]), [-s, -s, -s]);
  close(way("top", [0, 1, 0]), [0, -1, 0], 0.011);
  // With z up the front looks along +y, and the right side along -x.
  close(way("front", [0, 0, 1]), [0, 1, 0]);
  close(way("right", [0, 0, 1]), [-1, 0, 0]);
  close(way("isometric", [0, 0, 1]), [-s, s, -s]);
  close(way("top", [0, 0, 1]), [0, 0, -1], 0.011);
  // From above, the front is below: what is nearer to the front view is lower in the picture.
  const above = numbered("top", camera, BOX, [0, 1, 0], 1.6);
  assert.ok(project(above, SIZE, [1, 0, 7]).y > project(above, SIZE, [1, 0, 0]).y);
  assert.ok(project(above, SIZE, [3, 0, 3]).x > project(above, SIZE, [-1, 0, 3]).x);
});

test("a numbered view has the whole model in the picture, and no more room than its ball needs", () => {
  for (const aspect of [0.4, 1, 2.5]) {
    for (const name of ["front", "right", "top", "isometric"]) {
      const camera = { position: [9, 9, 9], target: [0, 0, 0], up: [1, 0, 0], fov_y: 50 };
      const view = numbered(name, camera, BOX, [0, 1, 0], aspect);
      assert.equal(view.fov_y, 50);
      close(view.target, [1, 0, 3.5]);
      const ball = Math.sqrt(16 + 16 + 49) / 2;
      const narrow = Math.atan(Math.tan(25 * RADIANS) * Math.min(1, aspect));
      close(Math.asin(ball / apart(view.position, view.target)), narrow);
      for (let corner = 0; corner < 8; corner += 1) {
        const point = [0, 1, 2].map((axis) => ((corner >> axis) & 1 ? BOX.hi : BOX.lo)[axis]);
        const { x, y, depth } = project(view, [1000 * aspect, 1000], point);
        assert.ok(depth > 0 && x >= 0 && x <= 1000 * aspect && y >= 0 && y <= 1000, `${name} ${aspect}: ${x} ${y}`);
      }
    }
  }
});

test("a model of one point has an extent", () => {
  assert.equal(camera_of.extent({ lo: [1, 1, 1], hi: [1, 1, 1] }), 1);
  assert.equal(camera_of.extent({ lo: [0, 0, 0], hi: [2, 3, 6] }), 7);
});

test("what is sent as a camera is one", () => {
  const good = { position: [0, 0, 1], target: [0, 0, 0], up: [0, 1, 0], fov_y: 40 };
  assert.equal(is_camera(good), true);
  for (const change of [{ position: [0, 0, 0] }, { position: [0, NaN, 1] }, { target: [0, 0] }, { up: null },
    { fov_y: 0 }, { fov_y: 180 }, { fov_y: "40" }, { target: [0, Infinity, 0] }]) {
    assert.equal(is_camera({ ...good, ...change }), false, JSON.stringify(change));
  }
  assert.equal(is_camera(null), false);
  assert.equal(is_camera({}), false);
  assert.equal(same(good, { ...good, up: [0, 1, 0] }), true);
  for (const change of [{ position: [0, 0, 2] }, { target: [0, 1e-12, 0] }, { up: [0, 2, 0] }, { fov_y: 41 }]) {
    assert.equal(same(good, { ...good, ...change }), false, JSON.stringify(change));
  }
});

test("a view in an address opens again, in every bit", () => {
  for (const seed of SEEDS) {
    const { camera } = posed(seed);
    assert.deepEqual(from_text(to_text(camera)), camera);
  }
  const camera = { position: [1, 2.5, -3], target: [0, 0, 1e-7], up: [0, 0, 1], fov_y: 45 };
  assert.equal(to_text(camera), "1,2.5,-3,0,0,1e-7,0,0,1,45");
  for (const text of ["", null, undefined, "1,2,3", "1,2,3,4,5,6,7,8,9,10,11", "a,2,3,0,0,0,0,0,1,45",
    "1,2,3,0,0,,0,0,1,45", "1,2,3,1,2,3,0,0,1,45", "0,0,5,0,0,0,0,0,1,45", "1,2,3,0,0,0,0,0,0,45",
    "1,2,3,0,0,0,0,0,1,180", "1,2,3,0,0,Infinity,0,0,1,45"]) {
    assert.equal(from_text(text), null, String(text));
  }
});

test("no function changes its camera", () => {
  const freeze = (camera) => Object.freeze(Object.fromEntries(
    Object.entries(camera).map(([key, value]) => [key, Object.freeze(value)])));
  for (const { camera } of SEEDS.map(posed)) {
    const frozen = freeze(camera);
    orbit(frozen, 500, 3, 4);
    look(frozen, 500, 3, 4);
    pan(frozen, SIZE, 3, 4);
    zoom(frozen, SIZE, 1, 0.9, 3, 4);
    roll(frozen, 1);
    fly(frozen, [1, 2, 3]);
    const point = [1, 2, 3];
    const aimed = camera_of.look_at(frozen, point);
    assert.deepEqual(aimed, { ...camera, target: [1, 2, 3] });
    assert.notEqual(aimed.target, point);
  }
});
