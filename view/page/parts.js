// What is shown of the model: sections, up to three planes that cut away what lies behind them, and hidden materials.
//
// ```text
// eye, click, slider -> the wish, all of it -> the server -> state.parts, which every page gets
// ```
// Invariants: 1. a plane is six numbers, a point and a normal that points into what is kept, as `--section` has them;
// 2. a list that is too long to be told (both null) is left as it is: the wish names no materials then.

import { frame } from "./camera.js";
import { add, dot, middle, scale } from "./vector.js";
import { button, choice_row, element, once_a_frame, row, shown } from "./widgets.js";
import { PARTS_MAX, SECTIONS_MAX } from "./wire.js";

const AXES = ["x", "y", "z"];
/** Places of a slider across the model. */
const STEPS = 1000;
const WHOLE = { section: [], hidden_count: 0, hide: [], only: null };

export const point_of = (plane) => plane.slice(0, 3);
export const normal_of = (plane) => plane.slice(3);
const along = (axis, sign) => [0, 1, 2].map((at) => (at === axis ? sign : 0));

/** The axis that a normal is along, 0 to 2; -1 for none. */
export function axis_of(normal) {
  const parts = normal.filter((part) => part !== 0);
  return parts.length === 1 ? normal.findIndex((part) => part !== 0) : -1;
}

/** The axis that is next to `way`, and the sign of `way` along it. */
export function nearest_axis(way) {
  const axis = way.reduce((best, part, at) => (Math.abs(part) > Math.abs(way[best]) ? at : best), 0);
  return along(axis, way[axis] < 0 ? -1 : 1);
}

/** The direction in which a plane's offset grows: along an axis upwards, whichever side is kept. */
export function rule_of(normal) {
  const axis = axis_of(normal);
  return axis < 0 ? normal : along(axis, 1);
}

/** Least and greatest offset of the corners of a box along `rule`. */
export function offsets(bounds, rule) {
  const ends = rule.map((part, axis) => [part * bounds.lo[axis], part * bounds.hi[axis]]);
  const sum = (pick) => ends.reduce((total, end) => total + pick(...end), 0);
  return [sum(Math.min), sum(Math.max)];
}

/** A plane moved along its rule to `offset`. */
export function at_offset(plane, offset) {
  const [point, rule] = [point_of(plane), rule_of(normal_of(plane))];
  const moved = add(point, scale(rule, offset - dot(point, rule)));
  const axis = axis_of(rule);
  // Along an axis the number is the coordinate itself.
  return [...moved.map((part, at) => (at === axis ? offset : part)), ...normal_of(plane)];
}

/** What a page asks for so that parts are as `parts` says, with the materials `hidden` among `count` if they change. */
export function wish_of(parts, hidden = null, count = 0) {
  const { section } = parts;
  if (hidden === null) {
    const { hide, only } = parts;
    return hide !== null ? { section, hide } : only !== null ? { section, only } : { section };
  }
  const list = [...hidden].sort((a, b) => a - b);
  if (list.length <= PARTS_MAX) {
    return { section, hide: list };
  }
  const others = Array.from({ length: count }, (_, index) => index).filter((index) => !hidden.has(index));
  return others.length <= PARTS_MAX ? { section, only: others } : null;
}

export class Parts {
  constructor(app, panels) {
    this.app = app;
    this.panels = panels;
    this.send = once_a_frame((parts) => app.edit({ type: "parts", parts }));
  }

  get parts() {
    return this.app.state.parts ?? WHOLE;
  }

  /** Asks for it, and shows it at once; the server says what has come of it. */
  wish(wish) {
    if (wish === null || !this.app.may_edit()) {
      return false;
    }
    const count = this.app.state.material_count ?? 0;
    const { section, hide, only } = wish;
    const lists = hide ? { hide, only: null, hidden_count: hide.length }
      : only ? { hide: null, only, hidden_count: count - only.length } : {};
    this.app.state.parts = { ...this.parts, section, ...lists };
    this.app.wishes.made("parts");
    this.send(wish);
    return true;
  }

  // Materials.

  hides(index) {
    const { hide, only } = this.parts;
    return hide ? hide.includes(index) : only ? !only.includes(index) : false;
  }

  /** Indices of what is hidden; null where the list is too long to be told. */
  get hidden() {
    const { hide, only } = this.parts;
    if (hide === null && only === null) {
      return null;
    }
    const all = Array.from({ length: this.app.state.material_count ?? 0 }, (_, index) => index);
    return new Set(hide ?? all.filter((index) => !only.includes(index)));
  }

  /** False where that cannot be asked for. */
  change_hidden(hidden) {
    const is_asked = hidden !== null && this.wish(wish_of(this.parts, hidden, this.app.state.material_count));
    if (is_asked) {
      this.panels.rebuild();
    }
    return is_asked;
  }

  /** Hides what is shown, and the other way round; false where that cannot be asked for. */
  toggle(index) {
    const { hidden } = this;
    if (hidden && !hidden.delete(index)) {
      hidden.add(index);
    }
    return this.change_hidden(hidden);
  }

  only(index) {
    if (this.wish({ section: this.parts.section, only: [index] })) {
      this.panels.rebuild();
    }
  }

  show_all() {
    this.change_hidden(new Set());
  }

  /** Hides what was hit by a click. */
  hit(hit) {
    if (hit === null) {
      this.panels.say("Nothing is there");
    } else if (!this.hides(hit.material) && this.toggle(hit.material)) {
      this.panels.say(`${hit.name || `Material ${hit.material}`} is hidden`);
    }
  }

  /** The eye of a material in a list. */
  eye({ index, name }) {
    const hides = this.hides(index);
    const label = `${hides ? "Show" : "Hide"} ${name || `material ${index}`}`;
    const { hide, only } = this.parts;
    return button(hides ? "◌" : "●", () => this.toggle(index), { class: "quiet", "aria-label": label, title: label,
      "aria-pressed": String(!hides), disabled: hide === null && only === null });
  }

  /** Buttons for the material that is chosen, and for all. */
  buttons(chosen) {
    const { hidden_count } = this.parts;
    const count = hidden_count > 0 ? `${hidden_count} hidden` : "";
    return element("div", { class: "buttons" },
      button("Hide by a click", () => this.panels.take("hide"),
        { "aria-pressed": String(this.panels.tool === "hide"), title: "Delete hides what the pointer is on" }),
      chosen ? button("Only this", () => this.only(chosen.index)) : null,
      button("Show all", () => this.show_all(), { disabled: hidden_count === 0 }),
      element("span", { class: "hint" }, count));
  }

  // Sections.

  put(at, plane) {
    const section = [...this.parts.section];
    section.splice(at, 1, ...(plane ? [plane] : []));
    return this.wish(wish_of({ ...this.parts, section }));
  }

  /** Cuts at what the middle of the view sees, across the axis that is next to the view: what is nearer goes. */
  async add() {
    const { app } = this;
    if (app.camera === null || !app.may_edit()) {
      return;
    }
    const { width, height } = app.stage.getBoundingClientRect();
    const hit = await app.pick(width / 2, height / 2);
    const { lo, hi } = app.state.bounds;
    const point = hit?.position ?? middle(lo, hi);
    if (this.parts.section.length >= SECTIONS_MAX) {
      // Another one came while the model was asked.
      return;
    }
    this.put(this.parts.section.length, [...point, ...nearest_axis(frame(app.camera).forward)]);
    this.panels.rebuild();
  }

  /** The panel. */
  panel() {
    const { section } = this.parts;
    const none = element("p", { class: "hint" }, "None: the model is whole.");
    return [
      element("div", { class: "buttons" },
        button("+ Section", () => this.add(), { disabled: section.length >= SECTIONS_MAX })),
      ...(section.length > 0 ? section.map((plane, at) => this.editor(plane, at)) : [none]),
      element("p", { class: "hint" }, "A plane cuts away what lies behind it. Cuts of closed parts are filled."),
      this.buttons(null),
      element("p", { class: "hint" }, "Each material has an eye in the panel of the materials."),
    ];
  }

  editor(plane, at) {
    const name = `Section ${at + 1}`;
    const now = () => this.parts.section[at] ?? plane;
    const rebuild = (changed) => {
      this.put(at, changed);
      this.panels.rebuild();
    };
    const axis = axis_of(normal_of(plane));
    const choices = [...AXES.map((text) => [text, text.toUpperCase()]), ["view", "View"]];
    const turn = (choice) => {
      const chosen = AXES.indexOf(choice);
      const forward = frame(this.app.camera).forward;
      const normal = chosen < 0 ? forward : along(chosen, forward[chosen] < 0 ? -1 : 1);
      rebuild([...point_of(now()), ...normal]);
    };
    const flip = () => rebuild([...point_of(now()), ...normal_of(now()).map((part) => (part === 0 ? 0 : -part))]);
    const cut = element("fieldset", {},
      element("legend", {}, name),
      choice_row("Across", axis < 0 ? "view" : AXES[axis], choices, turn),
      this.offset_row(name, plane, (offset) => this.put(at, at_offset(now(), offset))),
      element("div", { class: "buttons" },
        button("Flip", flip, { "aria-label": `Flip ${name}`, title: "Keep the other side" }),
        button("Remove", () => rebuild(null), { "aria-label": `Remove ${name}` })));
    return cut;
  }

  /** A slider over the model, beside a field for the exact number. */
  offset_row(name, plane, changed) {
    const rule = rule_of(normal_of(plane));
    const [least, most] = offsets(this.app.state.bounds, rule);
    const offset = dot(point_of(plane), rule);
    const place = (number) => Math.round((STEPS * (number - least)) / (most - least || 1));
    const label = `${name}, offset`;
    const slider = element("input", { type: "range", min: 0, max: STEPS, "aria-label": `${label}, slider` });
    slider.value = place(offset);
    const field = element("input", { type: "number", step: "any", value: shown(offset), "aria-label": label });
    slider.addEventListener("input", () => {
      const number = least + ((most - least) * Number(slider.value)) / STEPS;
      field.value = shown(number);
      changed(number);
    });
    field.addEventListener("change", () => {
      if (field.value !== "" && field.checkValidity()) {
        slider.value = place(Number(field.value));
        changed(Number(field.value));
      }
    });
    const made = row("Offset", field);
    made.classList.add("with-slider");
    made.insertBefore(slider, field);
    return made;
  }
}
