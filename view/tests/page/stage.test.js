// Where the picture lies on the stage.

import assert from "node:assert/strict";
import { test } from "node:test";
import { page } from "./page.js";

const { box_in, pixel_at, size_for } = await page("stage");

test("the picture is as large as fits, in the middle", () => {
  assert.deepEqual(box_in([1000, 500], [200, 100]), { left: 0, top: 0, width: 1000, height: 500 });
  assert.deepEqual(box_in([1000, 500], [100, 100]), { left: 250, top: 0, width: 500, height: 500 });
  assert.deepEqual(box_in([1000, 500], [400, 100]), { left: 0, top: 125, width: 1000, height: 250 });
  // Without a picture it is all of the stage.
  assert.deepEqual(box_in([1000, 500], undefined), { left: 0, top: 0, width: 1000, height: 500 });
});

test("a place of the stage is a pixel of the picture, or outside", () => {
  const box = box_in([1000, 500], [100, 100]);
  const at = (x, y) => pixel_at(box, [100, 100], x, y);
  assert.deepEqual(at(250, 0), [0, 0]);
  assert.deepEqual(at(254.9, 5), [0, 1]);
  assert.deepEqual(at(500, 250), [50, 50]);
  assert.deepEqual(at(749.9, 499.9), [99, 99]);
  for (const [x, y] of [[249, 10], [750, 10], [300, -1], [300, 500]]) {
    assert.equal(at(x, y), null, `${x} ${y}`);
  }
  assert.equal(pixel_at(box, undefined, 500, 250), null);
});

test("a picture is asked for in the pixels of the screen, within the server's range", () => {
  assert.deepEqual(size_for([1000, 500], 1), [1000, 500]);
  assert.deepEqual(size_for([1000.4, 333.3], 1.5), [1501, 500]);
  assert.deepEqual(size_for([1000, 500], 0.5, [1, 8192]), [500, 250]);
  assert.deepEqual(size_for([1000, 3], 2, [16, 1024]), [1024, 16]);
  assert.deepEqual(size_for([0, 0], 2), [1, 1]);
});
