// The panel of the materials: find one by name or by a click on the picture, change it.
//
// ```text
// search, arrows, pick -> ask the server -> a part of the list -> rows, and the materials of it are known
// another page's edit  -> the material that it changed
// ```
// Invariants: 1. an edit sends the keys that changed alone; 2. the list is the server's: the page keeps the part that
// it shows, and the material that is chosen; 3. an answer that is not the one to the last question is dropped.

import { button, colour_row, element, once_a_frame, slider_row, swatch, switch_row } from "./widgets.js";
import { LIST_MAX } from "./wire.js";

/** From so many materials on there is a search. */
const SEARCH_FROM = 9;
const SHARE = { min: 0.001, max: 1 };
const EXPONENT = { min: 1, max: 1e6, zero: true };
const GLOW = { min: 1e-3, max: 1e4 };

export class Materials {
  constructor(app, panels) {
    this.app = app;
    this.panels = panels;
    this.part = { from: 0, found: 0, items: [] };
    this.chosen = null;
    this.search = "";
    this.asked = 0;
    this.waiting = {};
    this.send = once_a_frame((index) => this.flush(index));
    app.listen("materials", (part) => this.listed(part));
    app.listen("material", (material) => this.edited(material));
    app.listen("welcome", () => this.ask({ index: this.chosen?.index ?? 0 }));
  }

  get is_open() {
    return this.panels.open_name === "materials";
  }

  /** Asks for a part of the list: `{ from }` of those that are searched for, or `{ index }` for the one around it. */
  ask(place) {
    this.asked = this.app.next_id();
    const find = "index" in place ? {} : { find: this.search };
    this.app.connection.send({ type: "materials", id: this.asked, ...find, ...place });
  }

  listed({ id, from, found, items }) {
    if (id !== this.asked) {
      return;
    }
    this.part = { from, found, items };
    const index = this.wanted ?? this.chosen?.index ?? items[0]?.index;
    this.chosen = items.find((material) => material.index === index) ?? this.chosen ?? items[0] ?? null;
    this.wanted = null;
    this.show();
  }

  edited(material) {
    const at = this.part.items.findIndex(({ index }) => index === material.index);
    if (at >= 0) {
      this.part.items[at] = material;
    }
    if (this.chosen?.index === material.index) {
      this.chosen = material;
    }
    this.panels.refresh("materials");
  }

  /** Chooses what was picked on the picture. */
  select(index) {
    if (Number.isInteger(index)) {
      [this.wanted, this.search] = [index, ""];
      this.ask({ index });
    }
  }

  /** Changes keys of a material: at once here, on the next animation frame there. */
  change(material, values) {
    if (this.app.may_edit()) {
      Object.assign(material, values);
      Object.assign(this.waiting, values);
      this.send(material.index);
    }
  }

  flush(index) {
    const edit = this.waiting;
    this.waiting = {};
    this.app.edit({ type: "material", index, edit });
  }

  /** The panel. */
  panel() {
    this.list = element("ul", { class: "list choose materials", "aria-label": "Materials" });
    this.place = element("div", { class: "buttons" });
    const search = element("input", { type: "search", placeholder: "Find by name", value: this.search,
      "aria-label": "Find a material by name" });
    search.addEventListener("input", () => {
      this.search = search.value;
      this.ask({ from: 0 });
    });
    this.fill();
    const pick = button("Pick on the picture", () => this.panels.take("pick"),
      { "aria-pressed": String(this.panels.tool === "pick"), title: "Ctrl + click, or P" });
    return [
      element("div", { class: "buttons" }, pick),
      this.panels.parts.buttons(this.chosen),
      this.app.state.material_count >= SEARCH_FROM ? search : null,
      this.list,
      this.place,
      this.chosen ? this.editor(this.chosen) : null,
    ];
  }

  /** Shows another part of the list; the search keeps the keys while somebody types. */
  show() {
    if (!this.is_open) {
      return;
    }
    if (document.activeElement?.type === "search") {
      this.fill();
    } else {
      this.panels.rebuild();
    }
  }

  fill() {
    const { from, found, items } = this.part;
    this.list.replaceChildren(...items.map((material) => this.item(material)));
    const last = from + items.length;
    const step = (text, at, label) => button(text, () => this.ask({ from: at }),
      { "aria-label": label, disabled: at < 0 || at >= found });
    const back = from > 0 ? Math.max(0, from - LIST_MAX) : -1;
    const text = found === 0 ? "No material has such a name" : `${from + 1} to ${last} of ${found}`;
    const both = [step("‹", back, "Materials before"), step("›", last, "Materials after")];
    const arrows = found > items.length ? both : [];
    this.place.replaceChildren(...arrows, element("span", { class: "hint" }, text));
  }

  item(material) {
    const mark = element("span", { class: "dot" });
    const is_black = Math.max(...material.kd) <= 0;
    mark.style.background = swatch(is_black ? material.ks : material.kd);
    const choose = () => {
      this.chosen = material;
      this.panels.rebuild();
    };
    return element("li", {}, element("button",
      { type: "button", class: "name", "aria-pressed": String(material.index === this.chosen?.index), click: choose },
      mark, material.name),
      this.panels.parts.eye(material));
  }

  editor(material) {
    const change = (key) => (value) => this.change(material, { [key]: value });
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
