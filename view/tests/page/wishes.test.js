// States that come while a hand drags: those from before its newest wish leave it as it is.

import assert from "node:assert/strict";
import { test } from "node:test";
import { page } from "./page.js";

const { Wishes } = await page("wishes");

test("a state is older than a wish until it is of the event that brought it", () => {
  const wishes = new Wishes();
  assert.equal(wishes.is_unknown_to(0, "parts"), false);
  wishes.made("parts");
  // Not sent yet: no state knows it.
  assert.equal(wishes.is_unknown_to(7, "parts"), true);
  wishes.sent("parts", 8);
  assert.deepEqual([7, 8, 9].map((seq) => wishes.is_unknown_to(seq, "parts")), [true, false, false]);
  // Another key is another matter, and a state without a number is of no event.
  assert.equal(wishes.is_unknown_to(7, "lights"), false);
  assert.equal(wishes.is_unknown_to(undefined, "parts"), false);
  wishes.sent("settings", 9);
  assert.equal(wishes.is_unknown_to(8, "settings"), false, "what was not dragged is always taken");
  wishes.made("parts");
  wishes.forget();
  assert.equal(wishes.is_unknown_to(0, "parts"), false);
});
