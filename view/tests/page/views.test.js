// Views: the history, bookmarks, and the address, in a browser that is four plain objects.

import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { page } from "./page.js";

const { Views } = await page("views");

const view = (x) => ({ position: [x, 0, 1], target: [0, 0, 0], up: [0, 1, 0], fov_y: 40 });

let kept;
beforeEach(() => {
  kept = new Map();
  globalThis.window = { addEventListener() {} };
  globalThis.location = { hash: "", pathname: "/" };
  globalThis.history = { replaceState: (state, title, address) => { location.hash = address.replace(/^[^#]*/, ""); } };
  globalThis.localStorage = { getItem: (key) => kept.get(key) ?? null, setItem: (key, text) => kept.set(key, text) };
});

/** Views of a page that moves at once and rests. */
function views(state = {}, may_edit = true) {
  const app = { camera: view(0), state: { name: "room", views: [], home: view(0), ...state }, listen() {},
    may_edit: () => may_edit, panels: { refresh() {} }, notices: { info() {} } };
  app.views = new Views(app);
  app.jump = (camera) => {
    app.camera = camera;
    app.views.rested(camera);
  };
  return app;
}

test("the history goes back and forth, and a new view cuts off what was undone", () => {
  const app = views();
  [0, 1, 2, 3].forEach((x) => app.jump(view(x)));
  const x = () => app.camera.position[0];
  app.views.step(-1);
  app.views.step(-1);
  assert.equal(x(), 1);
  app.views.step(1);
  assert.equal(x(), 2);
  app.jump(view(7));
  app.views.step(1);
  assert.equal(x(), 7, "there is nothing after it");
  app.views.step(-1);
  assert.equal(x(), 2);
  app.views.step(-1);
  app.views.step(-1);
  app.views.step(-1);
  assert.equal(x(), 0, "there is nothing before it");
});

test("the history has a bound, and no view twice in a row", () => {
  const app = views();
  app.jump(view(1));
  app.jump(view(1));
  assert.equal(app.views.history.length, 1);
  for (let x = 0; x < 500; x += 1) {
    app.jump(view(x));
  }
  assert.equal(app.views.history.length, 200);
  assert.equal(app.views.at, 199);
  app.views.step(-1);
  assert.deepEqual(app.camera, view(498));
});

test("who may not move the view does not move in the history", () => {
  const app = views({}, false);
  [0, 1].forEach((x) => app.jump(view(x)));
  app.views.step(-1);
  assert.equal(app.views.at, 1);
});

test("the address holds the view at rest, and opens it again", () => {
  const app = views();
  location.hash = "#view=1,2,3,0,0,0,0,1,0,45&other=x";
  app.views.welcomed();
  assert.deepEqual(app.camera, { position: [1, 2, 3], target: [0, 0, 0], up: [0, 1, 0], fov_y: 45 });
  assert.deepEqual(app.views.history.length, 2, "the first view is the one before");
  app.jump(view(6));
  assert.equal(location.hash, "#view=6,0,1,0,0,0,0,1,0,40&other=x");
});

/** A plus sign in an address is a space: a link to a view of a model this large opened another one. */
test("a view of any size is read back from a link", async () => {
  const { to_text } = await page("camera");
  const app = views();
  const camera = { ...view(0), position: [1.5e21, -2e300, 3e-9] };
  // As the link is put together, and as an address bar may have it.
  location.hash = `#token=abc&view=${to_text(camera)}`;
  app.views.open_address();
  assert.deepEqual(app.camera, camera);
});

test("the cameras of the scene come round", () => {
  const app = views({ views: [view(1), view(2)] });
  const seen = [1, 2, 3].map(() => {
    app.views.next_camera();
    return app.camera.position[0];
  });
  assert.deepEqual(seen, [1, 2, 1]);
});

test("a browser that keeps nothing is told of, and nothing is said to be kept", () => {
  const app = views();
  const told = [];
  const show = ({ level, numbers }) => told.push([level, numbers]);
  app.notices = { info: (text) => told.push(["info", text]), show };
  localStorage.setItem = () => {
    throw new DOMException("the quota has been exceeded", "QuotaExceededError");
  };
  app.views.bookmark();
  assert.deepEqual(told, [["error", "QuotaExceededError"]]);
  assert.deepEqual(app.views.bookmarks(), []);
});

test("bookmarks are kept by the model's name, and what is none is left out", () => {
  const app = views();
  app.views.bookmark();
  app.camera = view(5);
  app.views.bookmark();
  assert.deepEqual(app.views.bookmarks(), [{ name: "View 1", camera: view(0) }, { name: "View 2", camera: view(5) }]);
  assert.deepEqual(views({ name: "garden" }).views.bookmarks(), []);
  // A name that has been taken is not given again.
  app.views.keep_bookmarks([{ name: "View 9", camera: view(1) }, { name: "The door", camera: view(2) }]);
  app.views.bookmark();
  assert.deepEqual(app.views.bookmarks().map(({ name }) => name), ["View 9", "The door", "View 10"]);
  for (const text of ["no list", "{}", "null", "[null, 3, {\"camera\": {}}]"]) {
    kept.set("trex-bookmarks room", text);
    assert.deepEqual(app.views.bookmarks(), [], text);
  }
});
