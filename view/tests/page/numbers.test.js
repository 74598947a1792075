// Numbers and colours as people read them, beside literals worked out by hand.

import assert from "node:assert/strict";
import { test } from "node:test";
import { page } from "./page.js";

const { bytes, linear, log_scale, short, shown, swatch } = await page("widgets");
const { milliseconds } = await page("statistics");

const reads = (call, rows) => rows.forEach(([number, text]) => assert.equal(call(number), text, `${number}`));

test("bytes have three digits and a unit of 1024", () => {
  reads(bytes, [
    [0, "0 B"], [999, "999 B"], [1000, "0.977 KiB"], [1024, "1.00 KiB"], [1536, "1.50 KiB"], [102400, "100 KiB"],
    [102_400_000, "97.7 MiB"], [2 ** 30, "1.00 GiB"], [12.5 * 2 ** 30, "12.5 GiB"], [3 * 2 ** 40, "3.00 TiB"],
    [999 * 1024, "999 KiB"],
  ]);
});

/** "1.00e+3 KiB" stood on the page, rates had all digits of their fraction, and 9.96 ms were "10.0 ms". */
test("what is rounded up to the next power is written as that one", () => {
  reads(bytes, [
    [999.6 * 1024, "0.976 MiB"], [999.4 * 1024, "999 KiB"], [1234 * 2 ** 40, "1234 TiB"],
    [1000 / 3, "333 B"], [0.2, "0 B"],
  ]);
  reads(milliseconds, [[9.94, "9.9 ms"], [9.96, "10 ms"]]);
});

test("counts have a prefix of 1000", () => {
  reads(short, [
    [0, "0"], [7, "7"], [999, "999"], [1000, "1.00 k"], [1234, "1.23 k"], [12_345, "12.3 k"], [123_456, "123 k"],
    [999_499, "999 k"], [999_500, "1.00 M"], [9_994_999, "9.99 M"], [9_995_000, "10.0 M"], [28_055_742, "28.1 M"],
    [1.5e9, "1.50 G"], [2e12, "2.00 T"], [3e15, "3000 T"], [0.25, "0.25"], [12.34, "12.3"], [-1500, "-1.50 k"],
  ]);
});

test("a number in a field has six digits, a whole one all", () => {
  reads(shown, [
    [0, "0"], [-0, "0"], [5, "5"], [123_456_789, "123456789"], [0.1 + 0.2, "0.3"], [1 / 3, "0.333333"],
    [-1234.56789, "-1234.57"], [1e-7, "1e-7"], [NaN, ""], [Infinity, ""],
  ]);
});

test("times have a tenth below ten", () => {
  reads(milliseconds, [[0, "0.0 ms"], [0.26, "0.3 ms"], [9.94, "9.9 ms"], [10, "10 ms"],
    [1234.5, "1235 ms"], [undefined, "-"], [NaN, "-"]]);
});

test("a swatch is the hue at full, as sRGB encodes it", () => {
  // 0.5 is 188 (187.5), 0.25 is 137 (136.96), 0.001 lies on the straight piece: 3.29.
  reads(swatch, [[[1, 1, 1], "#ffffff"], [[1, 0, 0], "#ff0000"], [[2, 1, 0.5], "#ffbc89"], [[1000, 1, 0], "#ff0300"],
    [[0, 0, 0], "#ffffff"]]);
});

test("a colour that was picked is read back", () => {
  for (let byte = 0; byte < 256; byte += 1) {
    const pair = byte.toString(16).padStart(2, "0");
    assert.equal(swatch(linear(`#ff${pair}00`)), `#ff${pair}00`);
  }
  const [red, green, blue] = linear("#80ff0a");
  assert.ok(Math.abs(red - 0.2158605) < 1e-6 && green === 1 && Math.abs(blue - 0.0030353) < 1e-6);
});

test("a slider's places are even in the logarithm", () => {
  const { place, number_at } = log_scale({ min: 0.01, max: 100, zero: true }, 200);
  const near = (a, b) => assert.ok(Math.abs(a / b - 1) < 1e-12, `${a} is not ${b}`);
  reads(place, [[0.01, 0], [1, 100], [100, 200], [0.1, 50], [0, 0], [-3, 0], [1e9, 200], [1e-9, 0]]);
  assert.equal(number_at(0), 0);
  near(number_at(100), 1);
  near(number_at(200), 100);
  for (let at = 1; at <= 200; at += 1) {
    assert.equal(place(number_at(at)), at);
  }
  near(log_scale({ min: 0.01, max: 100 }, 200).number_at(0), 0.01);
});
