// Where the picture lies on the stage, and how large it should be: pure functions of sizes, [width, height].

/** The box of a picture of `size` pixels, as large as fits a stage, in its middle; all of it while there is none. */
export function box_in(stage, size) {
  const [columns, rows] = size ?? stage;
  const scale = Math.min(stage[0] / columns, stage[1] / rows);
  const [width, height] = [columns * scale, rows * scale];
  return { left: (stage[0] - width) / 2, top: (stage[1] - height) / 2, width, height };
}

/** The pixel of a picture of `size`, shown in `box`, at a place of the stage; null outside of it. */
export function pixel_at(box, size, x, y) {
  const [columns, rows] = size ?? [0, 0];
  const pixel = [((x - box.left) / box.width) * columns, ((y - box.top) / box.height) * rows].map(Math.floor);
  return pixel[0] >= 0 && pixel[1] >= 0 && pixel[0] < columns && pixel[1] < rows ? pixel : null;
}

/** The size to ask for: `pixels` a CSS pixel of the stage, each side in the range [least, most]. */
export function size_for(stage, pixels, [least, most] = [1, Infinity]) {
  return stage.map((side) => Math.max(least, Math.min(most, Math.round(side * pixels))));
}
