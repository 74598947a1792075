// Hooks of node's loader: `wire.js` of the page, from the table in `view/src/wire.rs`.
//
// Numbers that the table takes from another crate are NaN here: no test asks for them.

import { readFile } from "node:fs/promises";

const ADDRESS = "wire:numbers";
const TABLE = new URL("../../src/wire.rs", import.meta.url);
const ROW = /^ {4}([A-Z_]+): \w+ = (.+);$/gm;

export function resolve(specifier, context, next) {
  const is_wire = specifier === "./wire.js";
  return is_wire ? { url: ADDRESS, format: "module", shortCircuit: true } : next(specifier, context);
}

export async function load(url, context, next) {
  if (url !== ADDRESS) {
    return next(url, context);
  }
  const rows = [...(await readFile(TABLE, "utf8")).matchAll(ROW)];
  const source = rows.map(([, name, value]) => `export const ${name} = ${Number(value)};\n`).join("");
  return { format: "module", source, shortCircuit: true };
}
