// The panel of the picture: how light is computed, how well, how it is shown, and how much memory it may take.
//
// Invariants: 1. labels, ranges and choices of the settings are the server's (`keys` of its welcome), and so is which
// integrator uses what: nothing else is shown; 2. a change sends the keys that changed alone; 3. a debug view keeps the
// integrator that it stands over, and goes back to it; 4. what it is laid over is of the same view.

import { button, choice_row, element, number_row, slider_row, switch_row } from "./widgets.js";

/** Keys with controls of their own; the others are rows of the table. */
const APART = ["quality", "integrator", "light", "resolution", "exposure"];
/** Those that the debug key goes through. */
const DEBUG_KEYS = ["debug-upper", "debug-pages"];
const MOVING = [
  ["0", "What fits the time"],
  ["2", "Half"],
  ["4", "A quarter"],
  ["8", "An eighth"],
  ["1", "Off: full size"],
];
const SHOWN_THROUGH = [["1", "In place of the picture"], ["0.6", "Over the picture"], ["0.3", "Over it, faintly"]];
const SHARES = [["1", "Of this screen"], ["0.5", "Half of it"], ["0.25", "A quarter of it"]];
const MIB = 1024 * 1024;
const is_debug = (name) => name?.startsWith("debug-") ?? false;
/** Of the slider of the exposure; its field takes what the key does. */
const EXPOSURES = { min: 1 / 64, max: 64 };

export class Settings {
  constructor(app) {
    this.app = app;
    this.moving = "0";
    this.before_debug = { integrator: "photon" };
    this.share = 0.6;
    this.under = document.getElementById("under");
    // The picture below is of the view that it was kept in.
    app.listen("moved", () => app.picture.drop_under(this.under));
    app.listen("size", () => app.picture.drop_under(this.under));
    // The server may have refused the debug view.
    app.listen("settings", ({ integrator }) => is_debug(integrator) || app.picture.drop_under(this.under));
    app.listen("welcome", () => {
      if (this.moving !== "0" && app.drives) {
        app.connection.send({ type: "moving", scale: Number(this.moving) });
      }
    });
  }

  get now() {
    return this.app.state.settings;
  }

  /** Changes settings and shows the panel as it is then. */
  set(values) {
    this.app.set_settings(values);
  }

  integrator(name) {
    const { integrator, filter, bake, caustics } = this.now;
    const was_debug = is_debug(integrator);
    // What it has no use for the server turns off.
    const back = was_debug && name === this.before_debug.integrator ? this.before_debug : { integrator: name };
    if (!was_debug) {
      this.before_debug = { integrator, filter, bake, caustics };
    }
    this.lay_over(name);
    this.set(back);
    this.app.panels.rebuild();
  }

  /** Lays a debug view over the picture that is shown; takes it away again with any other. */
  lay_over(name) {
    const { picture } = this.app;
    if (!is_debug(name)) {
      picture.drop_under(this.under);
    } else if (!is_debug(this.now.integrator) && this.share < 1 && this.app.drives) {
      picture.keep_under(this.under, this.share);
    }
  }

  /** The next debug view; after the last one the picture again. */
  next_debug() {
    const at = DEBUG_KEYS.indexOf(this.now.integrator);
    const name = DEBUG_KEYS[at + 1] ?? this.before_debug.integrator;
    this.integrator(name);
    this.app.panels.say(this.app.key("integrator").choices.find((choice) => choice.name === name)?.title ?? name);
  }

  /** The panel. */
  panel() {
    return [...this.light(), ...this.quality(), ...this.display(), ...this.memory()];
  }

  light() {
    const { now: { integrator }, before_debug: before } = this;
    const { title, choices, text } = this.app.key("integrator");
    const lamps = this.app.key("light");
    const debug = choices.filter(({ name }) => is_debug(name)).map((choice) =>
      button(choice.title, () => this.integrator(integrator === choice.name ? before.integrator : choice.name),
        { "aria-pressed": String(integrator === choice.name), title: choice.text }));
    const methods = pairs(choices.filter(({ name }) => !is_debug(name)));
    const blend = (share) => {
      this.share = Number(share);
      if (!this.under.hidden) {
        this.app.picture.canvas.style.opacity = share;
      }
    };
    return [
      choice_row(title, is_debug(integrator) ? before.integrator : integrator, methods,
        (name) => this.integrator(name), text),
      lamps.methods.includes(integrator)
        ? choice_row(lamps.title, this.now.light, pairs(lamps.choices), (light) => this.set({ light }), lamps.text)
        : null,
      element("div", { class: "buttons", role: "group", "aria-label": "Debug views" }, ...debug),
      choice_row("Debug views", String(this.share), SHOWN_THROUGH, blend, "Until the view moves"),
    ];
  }

  quality() {
    const { integrator, quality } = this.now;
    const presets = this.app.key("quality").choices.map(({ name, title, text }) => {
      const choose = () => {
        this.set({ quality: name });
        this.app.panels.rebuild();
      };
      return button(title, choose, { "aria-pressed": String(name === quality), title: text });
    });
    const is_row = ({ name, methods }) => !APART.includes(name) && methods.includes(integrator);
    const rows = this.app.state.keys.filter(is_row);
    return [
      element("h3", {}, "Quality"),
      element("div", { class: "buttons", role: "group", "aria-label": "Quality" }, ...presets),
      ...rows.map((key) => this.row(key)),
    ];
  }

  /** The row of a key, by its kind. */
  row({ name, title, text, unit, kind, min, max, narrower, choices }) {
    const value = this.now[name];
    const change = (changed) => this.set({ [name]: changed });
    if (kind === "choice") {
      return choice_row(title, value, pairs(choices), change, text);
    }
    if (kind === "flag") {
      return switch_row(title, value, change, text);
    }
    const [method, fewer] = narrower ?? [];
    const most = method === this.now.integrator ? fewer : max;
    const hint = `${text}; ${min} to ${most} ${unit}`;
    return number_row(title, value, { min, max: most, step: kind === "count" ? 1 : "any" }, change, hint);
  }

  display() {
    const { app } = this;
    const moving = (scale) => {
      if (app.may_edit()) {
        this.moving = scale;
        app.connection.send({ type: "moving", scale: Number(scale) });
      }
    };
    const share = (value) => {
      app.pixel_share = Number(value);
      app.send_size();
    };
    const [width, height] = app.state.size ?? [0, 0];
    const exposure = app.key("exposure");
    const fixed = ", fixed by the scene or the command";
    return [
      element("h3", {}, "Display"),
      slider_row(exposure.title, this.now.exposure ?? 1, { ...EXPOSURES, least: exposure.min, most: exposure.max },
        (value) => this.set({ exposure: value }), exposure.text),
      // The server says which number that is.
      button("Exposure for this view", () => app.edit({ type: "settings", settings: { exposure: "auto" } }),
        { id: "auto-exposure", title: "By the surfaces that are seen now; it stays while the view moves" }),
      choice_row("While moving", this.moving, MOVING, moving, "Size of the picture while the view moves"),
      app.state.follows_page === false ? null : choice_row("Pixels", String(app.pixel_share), SHARES, share),
      element("p", { class: "hint" }, `${width} × ${height} pixels${app.state.follows_page === false ? fixed : ""}.`),
    ];
  }

  memory() {
    const limit = (this.app.state.memory?.limit_bytes ?? 0) / MIB;
    const change = (mebibytes) => this.app.edit({ type: "limit", bytes: Math.round(mebibytes * MIB) });
    return [
      element("h3", {}, "Memory"),
      number_row("Limit, MiB", limit, { min: 1, max: 1 << 24 }, change, "Of the whole process, while it runs"),
    ];
  }
}

/** Choices as rows take them. */
const pairs = (choices) => choices.map(({ name, title }) => [name, title]);
