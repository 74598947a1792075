// Handles of the sections, drawn over the picture while their panel is open. A drag moves the plane along its normal.
//
// A handle stands where the plane is nearest to what the view turns about; its arrow points into what is kept.
// Invariant: what is drawn and what can be grabbed are the same list.

import { shift_at } from "./camera.js";
import { fill_arrow_head, nearest_handle } from "./handles.js";
import { add, cross, dot, length, scale, subtract } from "./vector.js";
import { at_offset, normal_of, point_of, rule_of } from "./parts.js";

/** Length of the arrow, of its head, and half the side of the square, CSS pixels. */
const ARROW_PIXELS = 34;
const HEAD_PIXELS = 8;
const SIDE_PIXELS = 7;
/** Below this share of its length a normal is seen too steeply for a drag along it: up and down move the plane then. */
const SEEN_SHARE = 0.15;

/** The point of `plane` that is nearest to `point`. */
export function foot(plane, point) {
  const normal = normal_of(plane);
  const off = dot(subtract(point, point_of(plane)), normal) / dot(normal, normal);
  return subtract(point, scale(normal, off));
}

/**
 * How far a plane moves along the unit vector `rule` when the hand moves its handle by `dx`, `dy` pixels: so far that
 * the handle stays beside the hand. `right`, `up`: what a pixel to the right and one up are at the handle, model units.
 */
export function way_of_drag(rule, right, up, dx, dy) {
  const pixel = length(right);
  // The vector as it is seen: its parts to the right and up.
  const [across, above] = [dot(rule, right) / pixel, dot(rule, up) / pixel];
  const seen = Math.hypot(across, above);
  if (seen < SEEN_SHARE) {
    // Upwards is away from the viewer.
    return Math.sign(dot(rule, cross(right, up))) * dy * pixel;
  }
  return ((dx * across - dy * above) / (seen * seen)) * pixel;
}

export class SectionHandles {
  constructor(app, panels) {
    this.app = app;
    this.panels = panels;
    this.last = [];
    app.painters.push((context, place) => this.paint(context, place));
  }

  get are_shown() {
    return this.panels.open_name === "parts" && this.app.camera !== null;
  }

  /** Handles: {at, x, y, depth, way}; `way` is the direction of the arrow on the picture, a unit vector or zero. */
  placed(place) {
    const { target } = this.app.camera;
    return this.panels.parts.parts.section.flatMap((plane, at) => {
      const point = foot(plane, target);
      const { x, y, depth } = place(point);
      const normal = normal_of(plane);
      const end = place(add(point, scale(normal, (0.05 * depth) / length(normal))));
      const far = Math.hypot(end.x - x, end.y - y);
      const way = far > 0 ? [(end.x - x) / far, (end.y - y) / far] : [0, 0];
      return depth > 0 ? [{ at, x, y, depth, way }] : [];
    });
  }

  is_on(at) {
    return nearest_handle(this.last, at) !== undefined;
  }

  /** The handle at a place of the picture as what a drag moves; null for none. */
  grab(place) {
    const handle = nearest_handle(this.last, place);
    if (handle === undefined || !this.app.may_edit()) {
      return null;
    }
    const { app, panels } = this;
    return {
      drag: (dx, dy, size) => {
        const plane = panels.parts.parts.section[handle.at];
        if (plane) {
          const rule = rule_of(normal_of(plane));
          const [right, up] = [[1, 0], [0, -1]].map((way) => shift_at(app.camera, size, handle.depth, ...way));
          const way = way_of_drag(rule, right, up, dx, dy);
          panels.parts.put(handle.at, at_offset(plane, dot(point_of(plane), rule) + way));
          app.paint();
        }
      },
      drop: () => {
        panels.refresh("parts");
        app.connection.send({ type: "rest" });
      },
    };
  }

  paint(context, place) {
    this.last = this.are_shown ? this.placed(place) : [];
    for (const { x, y, way } of this.last) {
      const tip = { x: x + ARROW_PIXELS * way[0], y: y + ARROW_PIXELS * way[1] };
      for (const [width, style] of [[4.5, "rgba(0, 0, 0, 0.65)"], [2, "#ffb454"]]) {
        [context.lineWidth, context.strokeStyle, context.fillStyle] = [width, style, style];
        context.beginPath();
        context.moveTo(x, y);
        context.lineTo(tip.x, tip.y);
        context.stroke();
        fill_arrow_head(context, tip, Math.atan2(way[1], way[0]), HEAD_PIXELS);
        context.strokeRect(x - SIDE_PIXELS, y - SIDE_PIXELS, 2 * SIDE_PIXELS, 2 * SIDE_PIXELS);
      }
    }
  }
}
