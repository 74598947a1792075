// Modules of the page for tests, which run outside of a browser: `await page("camera")`.
//
// The page imports `wire.js`, which the server makes of `view/src/wire.rs`. Here `wire_hooks.js` makes it.

import { register } from "node:module";

register("./wire_hooks.js", import.meta.url);

/** A module of the page by its name without an ending. */
export const page = (name) => import(`../../page/${name}.js`);

/** `count` numbers of a fixed sequence, each at least 0 and less than 1 (a linear congruential generator). */
export function* random(seed, count) {
  let state = seed >>> 0;
  for (let at = 0; at < count; at += 1) {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    yield state / 2 ** 32;
  }
}

/** What can be called and read without an end, and is 0 as a number: for code of which only the way matters. */
export const anything = () => new Proxy(() => {}, {
  get: (target, key) => (key === Symbol.toPrimitive ? () => 0 : key === "then" ? undefined : anything()),
  apply: () => anything(),
});
