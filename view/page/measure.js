// Picks and measures: what lies under a click, and the distance between two such points, drawn over the picture.
//
// Invariant: a measure is two points of the surface; one with a point missing waits for its second click.

import { distance, middle, subtract } from "./vector.js";
import { button, element, encoded, shown } from "./widgets.js";

const MEASURES_MAX = 50;
const DOT_PIXELS = 4;

export class Measure {
  constructor(app, panels) {
    this.app = app;
    this.panels = panels;
    this.hit = null;
    this.first = null;
    this.measures = [];
    app.painters.push((context, place) => this.paint(context, place));
  }

  picked(hit) {
    this.hit = hit;
    this.panels.refresh("measure");
    this.app.paint();
  }

  tool_changed(tool) {
    this.first = null;
    if (tool === "measure") {
      this.panels.say("Click the first point");
    }
    this.app.paint();
  }

  /** A click with the measuring tool. */
  point(hit) {
    if (hit === null) {
      this.panels.say("Nothing is there");
      return;
    }
    this.hit = hit;
    if (this.first === null) {
      this.first = hit.position;
      this.panels.say("Click the second point");
    } else {
      this.measures = [...this.measures, [this.first, hit.position]].slice(-MEASURES_MAX);
      this.first = null;
      this.panels.say(`Distance ${shown(distance(...this.measures.at(-1)))}`);
    }
    this.panels.refresh("measure");
    this.app.paint();
  }

  /** The panel. */
  panel() {
    const tool = (name, text, keys) =>
      button(text, () => this.panels.take(name), { "aria-pressed": String(this.panels.tool === name), title: keys });
    const clear = () => {
      [this.measures, this.first, this.hit] = [[], null, null];
      this.panels.rebuild();
      this.app.paint();
    };
    return [
      element("div", { class: "buttons" }, tool("pick", "Pick", "Ctrl + click, or P"), tool("measure", "Measure", "M"),
        button("Clear", clear)),
      element("h3", {}, "Picked"),
      this.hit ? this.facts(this.hit) : element("p", { class: "hint" }, "Ctrl + click on the picture."),
      element("h3", {}, "Measured"),
      this.measures.length > 0
        ? element("ul", { class: "list" }, ...this.measures.map((ends, at) => this.item(ends, at)))
        : element("p", { class: "hint" }, "Press M and click two points."),
    ];
  }

  facts(hit) {
    const vector = (numbers) => numbers.map(shown).join("  ");
    const dot = element("span", { class: "dot" });
    dot.style.background = encoded(hit.colour);
    const is_smooth = hit.shading_normal.some((part, at) => part !== hit.normal[at]);
    const rows = [
      ["Triangle", hit.triangle === null ? "none: the cap of a section" : String(hit.triangle)],
      ["Material", `${hit.name} (${hit.material})`],
      ["Position", vector(hit.position)],
      ["Colour", element("span", {}, dot, encoded(hit.colour))],
      ["Normal", vector(hit.normal)],
      ["Smooth normal", is_smooth ? vector(hit.shading_normal) : null],
      ["Distance", shown(hit.distance)],
      ["Page", hit.page === null ? null : String(hit.page)],
    ];
    const parts = rows.filter(([, text]) => text !== null);
    return element("dl", { class: "facts" },
      ...parts.flatMap(([name, text]) => [element("dt", {}, name), element("dd", {}, text)]));
  }

  item([from, to], at) {
    const remove = () => {
      this.measures = this.measures.filter((_, other) => other !== at);
      this.panels.rebuild();
      this.app.paint();
    };
    const along = subtract(to, from).map(shown).join("  ");
    return element("li", { class: "measured" },
      element("span", {}, element("strong", {}, shown(distance(from, to))), element("small", {}, along)),
      button("×", remove, { class: "quiet", "aria-label": `Remove measure ${at + 1}` }));
  }

  paint(context, place) {
    for (const [from, to] of this.measures) {
      const [a, b] = [place(from), place(to)];
      if (a.depth > 0 && b.depth > 0) {
        line(context, a, b);
        label(context, place(middle(from, to)), shown(distance(from, to)));
      }
    }
    const points = [...this.measures.flat(), this.first, this.hit?.position].filter(Boolean).map(place);
    points.filter((point) => point.depth > 0).forEach((point) => dot(context, point));
  }
}

function line(context, a, b) {
  for (const [width, style] of [[4, "rgba(0, 0, 0, 0.55)"], [1.75, "#ffb454"]]) {
    context.beginPath();
    context.moveTo(a.x, a.y);
    context.lineTo(b.x, b.y);
    [context.lineWidth, context.strokeStyle] = [width, style];
    context.stroke();
  }
}

function dot(context, { x, y }) {
  context.beginPath();
  context.arc(x, y, DOT_PIXELS, 0, 2 * Math.PI);
  [context.fillStyle, context.strokeStyle, context.lineWidth] = ["#ffb454", "rgba(0, 0, 0, 0.75)", 1.5];
  context.fill();
  context.stroke();
}

function label(context, { x, y }, text) {
  context.font = "600 13px system-ui, sans-serif";
  const { width } = context.measureText(text);
  context.fillStyle = "rgba(16, 18, 22, 0.82)";
  context.beginPath();
  context.roundRect(x - width / 2 - 7, y - 26, width + 14, 20, 5);
  context.fill();
  [context.fillStyle, context.textAlign, context.textBaseline] = ["#ffffff", "center", "middle"];
  context.fillText(text, x, y - 15.5);
}
