// Handles of the lights, drawn over the picture. A drag moves the light in the plane parallel to the picture.
//
// A point light has a handle at its place, an area light at its middle; a sun has one on the side of the view's target
// that it shines from; a sky has none.
// Invariant: what is drawn and what can be grabbed are the same list.

import { swatch } from "./widgets.js";
import { shift_at } from "./camera.js";
import { add, distance, length, scale, subtract, unit } from "./vector.js";

/** A handle can be grabbed this far from its middle, CSS pixels. */
const REACH_PIXELS = 16;
/** Sides of the head of an arrow: how far they are turned from where it points. */
const HEAD_TURN = 2.6;
const RADIUS_PIXELS = 8;
/** Handles keep this far off the picture's edge. */
const EDGE_PIXELS = 14;
/** Distance of a sun's handle from the view's target: a share of the picture's half height there, and of the way. */
const SUN_SHARE = 0.7;
const SUN_NEAREST = 0.5;

const within = (place, side) => Math.max(EDGE_PIXELS, Math.min(side - EDGE_PIXELS, place));

/** The nearest of some handles to a place of the picture, within reach; `undefined` for none. */
export function nearest_handle(handles, { x, y }) {
  const near = handles.map((handle) => ({ ...handle, far: Math.hypot(handle.x - x, handle.y - y) }));
  return near.filter((handle) => handle.far <= REACH_PIXELS).sort((a, b) => a.far - b.far)[0];
}

/** Fills the head of an arrow that ends at a place of the picture, `size` pixels long. */
export function fill_arrow_head(context, { x, y }, angle, size) {
  context.beginPath();
  for (const turn of [0, HEAD_TURN, -HEAD_TURN]) {
    context.lineTo(x + size * Math.cos(angle + turn), y + size * Math.sin(angle + turn));
  }
  context.closePath();
  context.fill();
}

export class Handles {
  constructor(app) {
    this.app = app;
    this.are_shown = false;
    this.selected = 0;
    this.hovered = -1;
    app.painters.push((context, place, size) => this.paint(context, place, size));
  }

  toggle(shown = !this.are_shown) {
    this.are_shown = shown;
    this.app.paint();
  }

  /** Suns have their handles on a sphere about the view's target that the picture holds. */
  get sun_sphere() {
    const { position, target, fov_y } = this.app.camera;
    const far = distance(position, target);
    const share = Math.min(SUN_NEAREST, SUN_SHARE * Math.tan((fov_y * Math.PI) / 360));
    return { center: target, radius: share * far };
  }

  /** The point where the handle of `light` is; null for one without. */
  point(light) {
    if (light.type === "point") {
      return light.position;
    }
    if (light.type === "rect") {
      return add(light.corner, scale(add(light.edge_u, light.edge_v), 0.5));
    }
    if (light.type === "directional") {
      const { center, radius } = this.sun_sphere;
      return subtract(center, scale(unit(light.direction), radius));
    }
    return null;
  }

  /** `light` with its handle at `point`. */
  with_point(light, point) {
    if (light.type === "point") {
      return { ...light, position: point };
    }
    if (light.type === "rect") {
      return { ...light, corner: add(light.corner, subtract(point, this.point(light))) };
    }
    const direction = subtract(this.sun_sphere.center, point);
    return length(direction) > 0 ? { ...light, direction: unit(direction) } : light;
  }

  /** Handles: {at, x, y, depth, missing}; one outside of the picture stands at its edge, `missing` pixels away. */
  placed(place, size) {
    return this.app.state.lights.flatMap((light, at) => {
      const point = this.are_shown && this.app.state.bounds ? this.point(light) : null;
      const { x, y, depth } = point ? place(point) : { depth: 0 };
      const [near_x, near_y] = [within(x, size[0]), within(y, size[1])];
      return depth > 0 ? [{ at, x: near_x, y: near_y, depth, missing: [near_x - x, near_y - y] }] : [];
    });
  }

  nearest(at) {
    return this.are_shown ? nearest_handle(this.last ?? [], at) : undefined;
  }

  hover(place) {
    const at = this.nearest(place)?.at ?? -1;
    if (at !== this.hovered) {
      this.hovered = at;
      this.app.paint();
    }
  }

  /** The handle at a place of the picture as what a drag moves; null for none. */
  grab(place) {
    const handle = this.nearest(place);
    if (handle === undefined || !this.app.may_edit()) {
      return null;
    }
    const { app } = this;
    this.selected = handle.at;
    app.panels.refresh("lights");
    let { missing } = handle;
    return {
      drag: (dx, dy, size) => {
        const lights = [...app.state.lights];
        const light = lights[handle.at];
        const point = light && this.point(light);
        if (point) {
          // One from outside of the picture comes to the hand first.
          const shift = shift_at(app.camera, size, handle.depth, dx + missing[0], dy + missing[1]);
          missing = [0, 0];
          lights[handle.at] = this.moved(light, point, shift);
          app.wish_lights(lights);
          this.send();
        }
      },
      drop: () => {
        app.panels.refresh("lights");
        app.connection.send({ type: "rest" });
      },
    };
  }

  /** A sun's handle stays on its sphere; others go where the hand goes. */
  moved(light, point, shift) {
    if (light.type !== "directional") {
      return this.with_point(light, add(point, shift));
    }
    const { center, radius } = this.sun_sphere;
    const way = subtract(add(point, shift), center);
    return this.with_point(light, add(center, scale(unit(way), radius)));
  }

  /** Sends the lights as they are, once an animation frame. */
  send() {
    if (!this.waits) {
      this.waits = true;
      requestAnimationFrame(() => {
        this.waits = false;
        this.app.set_lights(this.app.state.lights);
      });
    }
  }

  paint(context, place, size) {
    this.last = this.placed(place, size);
    for (const { at, x, y, missing } of this.last) {
      const light = this.app.state.lights[at];
      context.globalAlpha = missing.some((pixels) => pixels !== 0) ? 0.6 : 1;
      this.paint_shape(context, light, place, x, y);
      const colour = light.intensity ?? light.irradiance ?? light.radiance;
      const is_near = at === this.hovered || at === this.selected;
      context.beginPath();
      context.arc(x, y, RADIUS_PIXELS + (is_near ? 2 : 0), 0, 2 * Math.PI);
      context.fillStyle = swatch(colour);
      context.fill();
      context.lineWidth = 3.5;
      context.strokeStyle = "rgba(0, 0, 0, 0.65)";
      context.stroke();
      context.lineWidth = 1.75;
      context.strokeStyle = at === this.selected ? "#ffb454" : "#ffffff";
      context.stroke();
      context.globalAlpha = 1;
    }
  }

  /** The outline of an area light, or the way that a sun shines. */
  paint_shape(context, light, place, x, y) {
    const ends = [];
    if (light.type === "rect") {
      const { corner, edge_u, edge_v } = light;
      const other = add(corner, edge_u);
      ends.push(corner, other, add(other, edge_v), add(corner, edge_v), corner);
    } else if (light.type === "directional") {
      const from = this.point(light);
      ends.push(from, add(from, scale(subtract(this.sun_sphere.center, from), 0.45)));
    }
    const places = ends.map(place);
    if (places.length === 0 || places.some(({ depth }) => !(depth > 0))) {
      return;
    }
    for (const [width, style] of [[3.5, "rgba(0, 0, 0, 0.55)"], [1.5, "#ffffff"]]) {
      context.beginPath();
      places.forEach((end, at) => (at === 0 ? context.moveTo(end.x, end.y) : context.lineTo(end.x, end.y)));
      [context.lineWidth, context.strokeStyle] = [width, style];
      context.stroke();
    }
    if (light.type === "directional") {
      const tip = places[1];
      context.fillStyle = "#ffffff";
      fill_arrow_head(context, tip, Math.atan2(tip.y - y, tip.x - x), 9);
    }
  }
}
