// The panel of the lights: add, remove, kind, colour, strength, place. Every change sends all lights.
//
// Invariants: 1. a new light is as strong as suits the model's size: it lights the target about as much as a lamp in a
// room; 2. a change of kind keeps colour, place and what arrives at the model.

import { frame } from "./camera.js";
import { add, across, cross, distance, length, scale, subtract, unit } from "./vector.js";
import { button, choice_row, colour_row, element, once_a_frame, swatch, switch_row, vector_row } from "./widgets.js";
import { LIGHTS_MAX } from "./wire.js";

const KINDS = [["point", "Lamp"], ["directional", "Sun"], ["rect", "Area light"], ["sky", "Sky"]];
const NAMES = Object.fromEntries(KINDS);
/** Keys of the light's colour by kind, and the irradiance that a new one brings to the target, W/m^2. */
const COLOUR = { point: "intensity", directional: "irradiance", rect: "radiance", sky: "radiance" };
const IRRADIANCE = 1;
/** Side of a new area light, in distances to the target. */
const RECT_SIDE = 0.25;
/** A new light stands this far from the target, in the camera's distance. */
const STANDS_AT = 0.8;
const WHITE = [1, 1, 1];

export class Lights {
  constructor(app, handles) {
    this.app = app;
    this.handles = handles;
    this.send = once_a_frame((lights) => app.set_lights(lights));
  }

  closed() {
    this.handles.toggle(false);
  }

  get lights() {
    return this.app.state.lights;
  }

  /** Light `at` replaced by `light`; null takes it away. */
  put(at, light) {
    const lights = [...this.lights];
    lights.splice(at, 1, ...(light ? [light] : []));
    if (this.app.may_edit()) {
      this.app.wish_lights(lights);
      this.send(lights);
    }
  }

  /** All lights `factor` times as strong. */
  stronger(factor) {
    const lights = this.lights.map((light) => {
      const key = COLOUR[light.type];
      return { ...light, [key]: light[key].map((x) => x * factor) };
    });
    if (lights.length > 0 && this.app.may_edit()) {
      this.app.set_lights(lights);
      this.app.panels.refresh("lights");
      this.app.panels.say(factor > 1 ? "All lamps stronger" : "All lamps weaker");
    }
  }

  /** What `light` brings to the target, W/m^2. */
  arrives(light) {
    const strength = Math.max(...light[COLOUR[light.type]]);
    const point = this.handles.point(light);
    const far = point ? distance(point, this.app.camera.target) : 1;
    const shares = {
      point: () => 1 / far ** 2,
      directional: () => 1,
      rect: () => length(cross(light.edge_u, light.edge_v)) / far ** 2,
      sky: () => 2 * Math.PI,
    };
    const irradiance = strength * shares[light.type]();
    return irradiance > 0 && Number.isFinite(irradiance) ? irradiance : IRRADIANCE;
  }

  /** A light of `kind` in `colour` that brings `irradiance` to the target from `position`. */
  made(kind, position, colour, irradiance = IRRADIANCE) {
    const { target } = this.app.camera;
    const far = distance(position, target) || this.app.extent;
    const towards = unit(subtract(target, position), [0, -1, 0]);
    const of = (strength) => colour.map((x) => x * strength);
    if (kind === "point") {
      return { type: kind, position, intensity: of(irradiance * far * far) };
    }
    if (kind === "directional") {
      return { type: kind, direction: towards, irradiance: of(irradiance) };
    }
    if (kind === "sky") {
      return { type: kind, radiance: of(irradiance / Math.PI / 2) };
    }
    const side = RECT_SIDE * far;
    // It shines to the side of edge_u x edge_v.
    const edge_u = scale(across(towards), side);
    const edge_v = scale(unit(cross(towards, edge_u)), side);
    const corner = subtract(position, scale(add(edge_u, edge_v), 0.5));
    return { type: kind, corner, edge_u, edge_v, radiance: of(irradiance / RECT_SIDE ** 2) };
  }

  /** Where a light stands that has no place yet: over the shoulder of who looks. */
  get new_place() {
    const { camera } = this.app;
    const { right, up, forward } = frame(camera);
    const way = unit(add(add(scale(right, 0.5), scale(up, 0.6)), scale(forward, -1)));
    return add(camera.target, scale(way, distance(camera.position, camera.target) * STANDS_AT));
  }

  add(kind) {
    const { app } = this;
    if (app.camera === null) {
      return;
    }
    this.handles.selected = this.lights.length;
    app.set_lights([...this.lights, this.made(kind, this.new_place, WHITE)]);
    app.panels.rebuild();
  }

  /** The panel. */
  panel() {
    const { light_count = 0 } = this.app.state;
    if (light_count > 0 && this.lights.length === 0) {
      const text = `The scene has ${light_count} lights, more than a page can change. Its file has them all.`;
      return [element("p", { class: "hint" }, text)];
    }
    this.handles.toggle(true);
    const is_full = this.lights.length >= LIGHTS_MAX;
    const adds = KINDS.map(([kind, text]) => button(`+ ${text}`, () => this.add(kind), { disabled: is_full }));
    const at = Math.min(this.handles.selected, this.lights.length - 1);
    const items = this.lights.map((light, index) => this.item(light, index, index === at));
    const none = element("p", { class: "hint" }, "None: a sun and a pale sky of the renderer's own, or what glows.");
    return [
      element("div", { class: "buttons" }, ...adds),
      items.length ? element("ul", { class: "list choose", "aria-label": "Lights" }, ...items) : none,
      at >= 0 ? this.editor(this.lights[at], at) : null,
      switch_row("Handles over the picture", this.handles.are_shown, (on) => this.handles.toggle(on)),
      element("p", { class: "hint" }, "Drag a handle: its light moves in the plane of the picture."),
    ];
  }

  item(light, index, is_selected) {
    const mark = element("span", { class: "dot" });
    mark.style.background = swatch(light[COLOUR[light.type]]);
    const choose = () => {
      this.handles.selected = index;
      this.app.panels.rebuild();
      this.app.paint();
    };
    const remove = () => {
      this.put(index, null);
      this.app.panels.rebuild();
    };
    const name = `${NAMES[light.type]} ${index + 1}`;
    const attributes = { type: "button", class: "name", "aria-pressed": String(is_selected), click: choose };
    return element("li", {},
      element("button", attributes, mark, name),
      button("×", remove, { class: "quiet", "aria-label": `Remove ${name}` }));
  }

  editor(light, at) {
    const key = COLOUR[light.type];
    const now = () => this.lights[at] ?? light;
    const change = (values) => this.put(at, { ...now(), ...values });
    const most = Math.max(...light[key], 1e-6);
    const range = { min: most * 1e-3, max: most * 1e3 };
    const place = this.handles.point(light) ?? this.new_place;
    const colour = () => {
      const strongest = Math.max(...now()[key]);
      return strongest > 0 ? now()[key].map((x) => x / strongest) : WHITE;
    };
    const change_kind = (kind) => {
      this.put(at, this.made(kind, place, colour(), this.arrives(now())));
      this.app.panels.rebuild();
    };
    const rows = {
      point: () => [vector_row("Position", light.position, (position) => change({ position }))],
      directional: () => [vector_row("Direction", light.direction, (direction) => change({ direction }))],
      rect: () => ["corner", "edge_u", "edge_v"].map((name) =>
        vector_row({ corner: "Corner", edge_u: "Edge u", edge_v: "Edge v" }[name], light[name],
          (value) => change({ [name]: value }))),
      sky: () => [],
    };
    const units = { point: "W/sr", directional: "W/m²", rect: "W/m²/sr", sky: "W/m²/sr" };
    return element("fieldset", {},
      element("legend", {}, `${NAMES[light.type]} ${at + 1}`),
      choice_row("Kind", light.type, KINDS, change_kind),
      colour_row(units[light.type], light[key], range, (rgb) => change({ [key]: rgb })),
      ...rows[light.type]());
  }
}
