// The picture: frames of the server drawn on a canvas at the picture's own pixels.
//
// ```text
// binary message -> header -> decode (off this thread) -> draw -> next animation frame: acknowledge
//                          -> part of a whole picture: keep, acknowledge; with the last one go on as above
// ```
// Invariants: 1. frames are drawn in the order in which they came; 2. a frame is acknowledged in the first animation
// frame after it was drawn, or after it is known that it cannot be: a page that nobody sees asks for none; 3. what a
// message says of its length is checked before it is used; 4. parts of a picture that is no longer sent are dropped.

import {
  BLOCK_SIDE, FLAG_DONE, FLAG_MOVING, FRAME_HEAD_BYTES, KIND_BLOCKS, KIND_WHOLE, PART_HEAD_BYTES,
} from "./wire.js";

/** A whole picture takes at most so many bytes a pixel, and so many more. */
const WHOLE_PIXEL_BYTES = 4;
const WHOLE_FIXED_BYTES = 1 << 17;
/** How the pixels come: as they are, no colour management between the server's picture and ours. */
const AS_SENT = { colorSpaceConversion: "none", premultiplyAlpha: "none" };
/** Times kept for measuring. */
const TIMES_MAX = 4096;

/** The header of a frame; null for what is none. */
export function parse(buffer) {
  if (buffer.byteLength < FRAME_HEAD_BYTES) {
    return null;
  }
  const view = new DataView(buffer);
  const header = {
    kind: view.getUint8(0),
    flags: view.getUint8(1),
    scale: view.getUint16(2, true),
    frame: view.getUint32(4, true),
    seq: view.getUint32(8, true),
    width: view.getUint16(12, true),
    height: view.getUint16(14, true),
    columns: view.getUint16(16, true),
    count: view.getUint16(18, true),
  };
  const { kind, scale, width, height, columns, count } = header;
  header.data_at = FRAME_HEAD_BYTES + 2 * count + (kind === KIND_WHOLE ? PART_HEAD_BYTES : 0);
  header.is_moving = (header.flags & FLAG_MOVING) !== 0;
  header.is_done = (header.flags & FLAG_DONE) !== 0;
  const has_size = width > 0 && height > 0 && scale > 0;
  const is_blocks = kind === KIND_BLOCKS && columns > 0 && count > 0;
  const is_whole = kind === KIND_WHOLE && count === 0;
  if (!has_size || !(is_blocks || is_whole) || header.data_at >= buffer.byteLength) {
    return null;
  }
  if (is_whole) {
    [header.from, header.total] = [view.getUint32(FRAME_HEAD_BYTES, true), view.getUint32(FRAME_HEAD_BYTES + 4, true)];
    if (header.total > width * height * WHOLE_PIXEL_BYTES + WHOLE_FIXED_BYTES) {
      return null;
    }
  }
  header.blocks = [];
  for (let at = 0; at < count; at += 1) {
    header.blocks.push(view.getUint16(FRAME_HEAD_BYTES + 2 * at, true));
  }
  return header;
}

/**
 * Runs of blocks that lie side by side both in the atlas and in the picture: [from x, from y, to x, to y, length],
 * all in blocks. One copy each.
 */
export function runs(blocks, atlas_columns, picture_columns) {
  const found = [];
  for (let at = 0; at < blocks.length; at += 1) {
    const [from_x, from_y] = [at % atlas_columns, Math.floor(at / atlas_columns)];
    const [to_x, to_y] = [blocks[at] % picture_columns, Math.floor(blocks[at] / picture_columns)];
    const last = found.at(-1);
    const goes_on = last && last[1] === from_y && last[3] === to_y && last[0] + last[4] === from_x
      && last[2] + last[4] === to_x;
    if (goes_on) {
      last[4] += 1;
    } else {
      found.push([from_x, from_y, to_x, to_y, 1]);
    }
  }
  return found;
}

export class Picture {
  /** `canvas`: where it is drawn. `drawn(header)`: called after each draw. */
  constructor(canvas, drawn) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d", { alpha: false });
    this.small = document.createElement("canvas");
    this.small_context = this.small.getContext("2d", { alpha: false });
    this.drawn = drawn;
    this.order = Promise.resolve();
    this.last = null;
    this.parts = null;
    this.marks = { drawn: 0, failed: 0, times: [] };
  }

  /** Takes a message that may be a frame; false when it is none. `acknowledge(frame)` is called after the draw. */
  take(buffer, acknowledge) {
    const header = parse(buffer);
    if (header === null) {
      return false;
    }
    const received = performance.now();
    const data = this.gather(header, new Uint8Array(buffer, header.data_at));
    if (data === null) {
      acknowledge(header.frame);
      return true;
    }
    const decoded = createImageBitmap(data, AS_SENT).catch(() => null);
    this.order = this.order.then(async () => {
      const bitmap = await decoded;
      this.draw(header, bitmap);
      const drawn = performance.now();
      await new Promise((resolve) => requestAnimationFrame(resolve));
      this.mark(header, { received, drawn, bytes: data.size }, bitmap !== null);
      acknowledge(header.frame);
      this.drawn(header);
    });
    return true;
  }

  /** What is to be decoded: the blocks' own bytes, or all parts of a whole picture; null while some are to come. */
  gather(header, bytes) {
    if (header.kind === KIND_BLOCKS) {
      this.parts = null;
      return new Blob([bytes], { type: "image/jpeg" });
    }
    if (header.from === 0) {
      this.parts = { frame: header.frame, length: 0, list: [] };
    }
    const { parts } = this;
    if (parts === null || parts.frame !== header.frame || parts.length !== header.from) {
      this.parts = null;
      return null;
    }
    parts.list.push(bytes);
    parts.length += bytes.length;
    if (parts.length < header.total) {
      return null;
    }
    this.parts = null;
    return new Blob(parts.list, { type: "image/png" });
  }

  draw(header, bitmap) {
    this.fit(header.width, header.height);
    if (bitmap === null) {
      return;
    }
    if (header.kind === KIND_WHOLE) {
      this.context.imageSmoothingEnabled = false;
      this.context.drawImage(bitmap, 0, 0);
    } else if (header.scale === 1) {
      this.context.imageSmoothingEnabled = false;
      copy_blocks(this.context, bitmap, header, header.width);
    } else {
      this.draw_small(header, bitmap);
    }
    bitmap.close();
  }

  /**
   * Draws a small picture over the whole one, smoothed. Its pixels are the top left ones of their squares, so they
   * stand half a square up and to the left; the strips that this leaves at the far edges repeat the last pixels.
   */
  draw_small(header, bitmap) {
    const { context, small } = this;
    const { scale, width, height } = header;
    const [columns, rows] = [Math.ceil(width / scale), Math.ceil(height / scale)];
    if (small.width !== columns || small.height !== rows) {
      [small.width, small.height] = [columns, rows];
    }
    copy_blocks(this.small_context, bitmap, header, columns);
    context.imageSmoothingEnabled = true;
    context.imageSmoothingQuality = "low";
    const shift = -(scale - 1) / 2;
    const [drawn_width, drawn_height] = [columns * scale, rows * scale];
    const [right, bottom] = [drawn_width + shift, drawn_height + shift];
    context.drawImage(small, shift, shift, drawn_width, drawn_height);
    if (right < width) {
      context.drawImage(small, columns - 1, 0, 1, rows, right - 1, shift, width - right + 1, drawn_height);
    }
    if (bottom < height) {
      context.drawImage(small, 0, rows - 1, columns, 1, shift, bottom - 1, drawn_width, height - bottom + 1);
    }
  }

  /** Keeps what is shown below what comes, which then shows through by `share`: a debug view over the picture. */
  keep_under(under, share) {
    [under.width, under.height] = [this.canvas.width, this.canvas.height];
    under.getContext("2d", { alpha: false }).drawImage(this.canvas, 0, 0);
    under.hidden = false;
    this.canvas.style.opacity = String(share);
  }

  /** Shows what comes alone. */
  drop_under(under) {
    under.hidden = true;
    this.canvas.style.opacity = "";
  }

  /** Gives the canvas its size; what was shown stays, stretched, until the new picture comes. */
  fit(width, height) {
    const { canvas, context } = this;
    if (canvas.width === width && canvas.height === height) {
      return;
    }
    const before = document.createElement("canvas");
    [before.width, before.height] = [canvas.width, canvas.height];
    before.getContext("2d").drawImage(canvas, 0, 0);
    [canvas.width, canvas.height] = [width, height];
    context.drawImage(before, 0, 0, width, height);
  }

  mark(header, times, is_good) {
    const { marks } = this;
    this.last = header;
    marks.drawn += is_good ? 1 : 0;
    marks.failed += is_good ? 0 : 1;
    const { frame, seq, scale, kind, flags } = header;
    marks.times.push({ frame, seq, scale, kind, flags, ...times, shown: performance.now() });
    if (marks.times.length > TIMES_MAX) {
      marks.times.splice(0, TIMES_MAX / 2);
    }
  }
}

function copy_blocks(context, bitmap, header, width) {
  const picture_columns = Math.ceil(width / BLOCK_SIDE);
  for (const [from_x, from_y, to_x, to_y, length] of runs(header.blocks, header.columns, picture_columns)) {
    const [w, h] = [length * BLOCK_SIDE, BLOCK_SIDE];
    const [from, to] = [[from_x, from_y], [to_x, to_y]].map((place) => place.map((at) => at * BLOCK_SIDE));
    context.drawImage(bitmap, ...from, w, h, ...to, w, h);
  }
}
