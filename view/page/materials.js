// The panel of the materials: find one by name or by a click on the picture, change it.
//
// Invariants: 1. an edit sends the keys that changed alone; 2. at most LIST_MAX names are listed, the search finds the
// others.

import { button, colour_row, element, once_a_frame, slider_row, swatch, switch_row } from "./widgets.js";

const LIST_MAX = 100;
const SHARE = { min: 0.001, max: 1 };
const EXPONENT = { min: 1, max: 1e6, zero: true };
const GLOW = { min: 1e-3, max: 1e4 };

export class Materials {
  constructor(app, panels) {
    this.app = app;
    this.panels = panels;
    this.selected = 0;
    this.search = "";
    this.waiting = {};
    this.send = once_a_frame((index) => this.flush(index));
  }

  select(index) {
    if (Number.isInteger(index) && this.app.state.materials[index]) {
      this.selected = index;
      this.search = "";
    }
  }

  /** Changes keys of a material: at once here, on the next animation frame there. */
  change(index, values) {
    if (this.app.may_edit()) {
      Object.assign(this.app.state.materials[index], values);
      Object.assign(this.waiting, values);
      this.send(index);
    }
  }

  flush(index) {
    const edit = this.waiting;
    this.waiting = {};
    this.app.edit({ type: "material", index, edit });
  }

  /** The panel. */
  panel() {
    const { materials } = this.app.state;
    const list = element("ul", { class: "list choose materials", "aria-label": "Materials" });
    const fill = () => list.replaceChildren(...this.items(materials));
    const search = element("input", { type: "search", placeholder: "Find by name", value: this.search,
      "aria-label": "Find a material by name" });
    search.addEventListener("input", () => {
      this.search = search.value;
      fill();
    });
    fill();
    const pick = button("Pick on the picture", () => this.panels.take("pick"),
      { "aria-pressed": String(this.panels.tool === "pick"), title: "Ctrl + click, or P" });
    return [
      element("div", { class: "buttons" }, pick),
      materials.length > 8 ? search : null,
      list,
      materials[this.selected] ? this.editor(materials[this.selected], this.selected) : null,
    ];
  }

  items(materials) {
    const wanted = this.search.toLowerCase();
    const found = materials.map((material, index) => [material, index])
      .filter(([material]) => material.name.toLowerCase().includes(wanted));
    const items = found.slice(0, LIST_MAX).map(([material, index]) => this.item(material, index));
    const others = found.length - items.length;
    return others > 0 ? [...items, element("li", { class: "hint" }, `${others} more: find them by name`)] : items;
  }

  item(material, index) {
    const mark = element("span", { class: "dot" });
    const is_black = Math.max(...material.kd) <= 0;
    mark.style.background = swatch(is_black ? material.ks : material.kd);
    const choose = () => {
      this.selected = index;
      this.panels.rebuild();
    };
    return element("li", {}, element("button",
      { type: "button", class: "name", "aria-pressed": String(index === this.selected), click: choose },
      mark, material.name));
  }

  editor(material, index) {
    const change = (key) => (value) => this.change(index, { [key]: value });
    const glow = material.emits
      ? colour_row("Glow", material.ke, GLOW, change("ke"))
      : element("p", { class: "hint" }, "It cannot glow: only what glowed when the file was built can.");
    return element("fieldset", {},
      element("legend", {}, material.name),
      colour_row("Diffuse", material.kd, SHARE, change("kd")),
      colour_row("Glossy", material.ks, SHARE, change("ks")),
      slider_row("Exponent", material.ns, EXPONENT, change("ns"), "Greater is sharper"),
      switch_row("Mirror", material.mirror, change("mirror"), "Reflects the glossy colour"),
      glow);
  }
}
