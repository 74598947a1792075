// Frames: messages put together byte by byte here, and read by the page.

import assert from "node:assert/strict";
import { test } from "node:test";
import { page, random } from "./page.js";

const { Picture, parse, runs } = await page("picture");

/** Kinds of messages and flags, as `view/src/wire.rs` has them. */
const [BLOCKS, WHOLE, FILE] = [1, 2, 3];
const [MOVING, DONE] = [2, 8];

const u16 = (number) => [number & 255, number >> 8];
const u32 = (number) => [...u16(number & 0xffff), ...u16(number >>> 16)];

function message({ kind, flags = 0, scale = 1, frame = 9, seq = 5, width = 64, height = 32, columns = 0, count = 0,
  tail = [] }) {
  const sides = [width, height, columns, count].flatMap(u16);
  return Uint8Array.from([kind, flags, ...u16(scale), ...u32(frame), ...u32(seq), ...sides, ...tail]).buffer;
}

const blocks = (indices, data, more = {}) => message({ kind: BLOCKS, columns: 2, count: indices.length,
  tail: [...indices.flatMap(u16), ...data], ...more });
const part = (from, total, data, more = {}) =>
  message({ kind: WHOLE, tail: [...u32(from), ...u32(total), ...data], ...more });

test("the head of blocks is read number by number", () => {
  const buffer = blocks([3, 259], [0xff, 0xd8], { flags: MOVING, scale: 4, frame: 0x01020304, seq: 0xfffefdfc,
    width: 1920, height: 1080 });
  const head = parse(buffer);
  const expected = { kind: BLOCKS, flags: 2, scale: 4, frame: 0x01020304, seq: 0xfffefdfc, width: 1920, height: 1080,
    columns: 2, count: 2, blocks: [3, 259], data_at: 24, is_moving: true, is_done: false };
  assert.deepEqual(head, expected);
  assert.equal(buffer.byteLength, 26);
});

test("the head of a part of a whole picture says where it begins", () => {
  const head = parse(part(70_000, 100_000, [1], { flags: DONE, width: 300, height: 200 }));
  assert.deepEqual([head.from, head.total, head.data_at], [70_000, 100_000, 28]);
  assert.deepEqual([head.is_done, head.is_moving, head.blocks], [true, false, []]);
});

test("what is no frame is refused", () => {
  const good = new Uint8Array(blocks([0, 1], [7]));
  assert.notEqual(parse(good.buffer), null);
  for (let length = 0; length < good.length; length += 1) {
    assert.equal(parse(good.slice(0, length).buffer), null, `cut off after ${length}`);
  }
  const whole = new Uint8Array(part(0, 1, [7]));
  assert.notEqual(parse(whole.buffer), null);
  for (let length = 0; length < whole.length; length += 1) {
    assert.equal(parse(whole.slice(0, length).buffer), null, `cut off after ${length}`);
  }
  for (const bad of [
    message({ kind: FILE, tail: [1, 2, 3] }), message({ kind: 0, tail: [1] }), message({ kind: 255, tail: [1] }),
    blocks([0], [7], { width: 0 }), blocks([0], [7], { height: 0 }), blocks([0], [7], { scale: 0 }),
    blocks([0], [7], { columns: 0 }), blocks([], [7]), blocks([0], [7], { count: 60_000 }),
    part(0, 1, [7], { count: 1 }),
    // Longer than any picture of this size.
    part(0, 64 * 32 * 4 + (1 << 17) + 1, [7]),
  ]) {
    assert.equal(parse(bad), null, String(new Uint8Array(bad)));
  }
  assert.notEqual(parse(part(0, 64 * 32 * 4 + (1 << 17), [7])), null);
});

/** The parts of `list` on their way: what is to be decoded after each, null while more is to come. */
const gathered = (list) => {
  const picture = { parts: null, gather: Picture.prototype.gather };
  return list.map((buffer) => {
    const head = parse(buffer);
    return picture.gather(head, new Uint8Array(buffer, head.data_at));
  });
};

const content = async (blob) => [...new Uint8Array(await blob.arrayBuffer())];

test("parts of a picture become one file, in order", async () => {
  const [first, second, third] = gathered([part(0, 5, [1, 2]), part(2, 5, [3, 4]), part(4, 5, [5])]);
  assert.deepEqual([first, second], [null, null]);
  assert.deepEqual(await content(third), [1, 2, 3, 4, 5]);
  assert.equal(third.type, "image/png");
  const [jpeg] = gathered([blocks([0, 1], [8, 9])]);
  assert.deepEqual(await content(jpeg), [8, 9]);
  assert.equal(jpeg.type, "image/jpeg");
});

test("parts of a picture that is no longer sent are dropped", async () => {
  const nothing = (list) => assert.deepEqual(gathered(list), list.map(() => null));
  nothing([part(2, 4, [3, 4])]);
  nothing([part(0, 4, [1, 2]), part(3, 4, [4, 5])]);
  nothing([part(0, 4, [1, 2]), part(2, 4, [3, 4], { frame: 10 })]);
  const left = gathered([part(0, 4, [1, 2]), blocks([0], [9]), part(2, 4, [3, 4])]);
  assert.deepEqual([left[0], left[2]], [null, null]);
  // A new beginning is one.
  const begun = gathered([part(0, 4, [1, 2]), part(0, 3, [7, 8], { frame: 10 }), part(2, 3, [9], { frame: 10 })]);
  assert.deepEqual(await content(begun[2]), [7, 8, 9]);
});

test("runs of blocks put each block where the picture has it, in as few copies as there are runs", () => {
  assert.deepEqual(runs([0, 1, 2, 3], 4, 10), [[0, 0, 0, 0, 4]]);
  // A row of the atlas ends, a row of the picture ends, and blocks that are not neighbours.
  assert.deepEqual(runs([0, 1, 2, 3], 2, 10), [[0, 0, 0, 0, 2], [0, 1, 2, 0, 2]]);
  assert.deepEqual(runs([2, 3, 4], 8, 4), [[0, 0, 2, 0, 2], [2, 0, 0, 1, 1]]);
  assert.deepEqual(runs([5, 7], 8, 10), [[0, 0, 5, 0, 1], [1, 0, 7, 0, 1]]);
  assert.deepEqual(runs([], 8, 10), []);
  for (let seed = 1; seed <= 30; seed += 1) {
    const [a, b, ...draws] = random(seed, 62);
    const [atlas_columns, picture_columns] = [1 + Math.floor(9 * a), 1 + Math.floor(12 * b)];
    const list = draws.flatMap((draw, at) => (draw < 0.7 ? [at] : []));
    const copied = new Map();
    for (const [from_x, from_y, to_x, to_y, length] of runs(list, atlas_columns, picture_columns)) {
      assert.ok(from_x + length <= atlas_columns && to_x + length <= picture_columns);
      for (let step = 0; step < length; step += 1) {
        copied.set(from_y * atlas_columns + from_x + step, to_y * picture_columns + to_x + step);
      }
    }
    assert.deepEqual([...copied], list.map((block, at) => [at, block]));
  }
});
