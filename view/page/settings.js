// The panel of the picture: how light is computed, how well, how it is shown, and how much memory it may take.
//
// Invariants: 1. what an integrator has no use for is neither shown nor sent with it; 2. a change sends the keys that
// changed alone; 3. a debug view keeps the integrator that it stands over, and goes back to it; 4. what it is laid over
// is of the same view.

import { button, choice_row, element, number_row, slider_row, switch_row } from "./widgets.js";

const INTEGRATORS = [
  ["direct", "Direct light"],
  ["photon", "All light, photons and voxels"],
  ["full-gi", "All light, photons on the mesh"],
  ["path", "All light, paths"],
  ["ao", "Ambient occlusion"],
];
const DEBUG_VIEWS = [
  ["debug-upper", "Voxels"],
  ["debug-lower", "Finest voxels"],
  ["debug-occluders", "Bitmaps"],
  ["debug-pages", "Pages"],
];
/** Those that the debug key goes through. */
const DEBUG_KEYS = ["debug-upper", "debug-pages"];
const PRESETS = [
  ["Draft", { spp: 4, n_shadow: 1, n_gather: 1, lod_error: 2 }],
  ["Normal", { spp: 16, n_shadow: 2, n_gather: 2, lod_error: 1 }],
  ["Reference", { spp: 256, n_shadow: 4, n_gather: 4, lod_error: 0 }],
];
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
const gathers = (integrator) => integrator === "photon" || integrator === "full-gi";

export class Settings {
  constructor(app) {
    this.app = app;
    this.moving = "0";
    this.before_debug = "photon";
    this.share = 0.6;
    this.under = document.getElementById("under");
    // The picture below is of the view that it was kept in.
    app.listen("moved", () => app.picture.drop_under(this.under));
    app.listen("size", () => app.picture.drop_under(this.under));
    // The server may have refused the debug view.
    app.listen("settings", ({ integrator }) => integrator?.startsWith("debug-") || app.picture.drop_under(this.under));
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
    if (!this.now.integrator?.startsWith("debug-")) {
      this.before_debug = this.now.integrator ?? this.before_debug;
    }
    this.lay_over(name);
    const values = { integrator: name };
    if (!gathers(name) && this.now.filter === "on") {
      values.filter = "off";
    }
    if (name !== "photon" && this.now.bake) {
      values.bake = false;
    }
    this.set(values);
    this.app.panels.rebuild();
  }

  /** Lays a debug view over the picture that is shown; takes it away again with any other. */
  lay_over(name) {
    const { picture } = this.app;
    const [is_debug, was_debug] = [name, this.now.integrator ?? ""].map((text) => text.startsWith("debug-"));
    if (!is_debug) {
      picture.drop_under(this.under);
    } else if (!was_debug && this.share < 1 && this.app.drives) {
      picture.keep_under(this.under, this.share);
    }
  }

  /** The next debug view; after the last one the picture again. */
  next_debug() {
    const at = DEBUG_KEYS.indexOf(this.now.integrator);
    const name = DEBUG_KEYS[at + 1] ?? this.before_debug;
    this.integrator(name);
    const text = [...INTEGRATORS, ...DEBUG_VIEWS].find(([key]) => key === name)?.[1] ?? name;
    this.app.panels.say(text);
  }

  /** The panel. */
  panel() {
    return [...this.light(), ...this.quality(), ...this.display(), ...this.memory()];
  }

  light() {
    const { integrator } = this.now;
    const is_debug = integrator?.startsWith("debug-");
    const debug = DEBUG_VIEWS.map(([name, text]) =>
      button(text, () => this.integrator(integrator === name ? this.before_debug : name),
        { "aria-pressed": String(integrator === name) }));
    const blend = (share) => {
      this.share = Number(share);
      if (!this.under.hidden) {
        this.app.picture.canvas.style.opacity = share;
      }
    };
    return [
      choice_row("Light", is_debug ? this.before_debug : integrator, INTEGRATORS, (name) => this.integrator(name)),
      element("div", { class: "buttons", role: "group", "aria-label": "Debug views" }, ...debug),
      choice_row("Debug views", String(this.share), SHOWN_THROUGH, blend, "Until the view moves"),
    ];
  }

  quality() {
    const { integrator, spp, n_shadow, n_gather, lod_error, photons } = this.now;
    const presets = PRESETS.map(([name, values]) => {
      const is_in_force = Object.entries(values).every(([key, value]) => this.now[key] === value);
      const choose = () => {
        this.set(values);
        this.app.panels.rebuild();
      };
      return button(name, choose, { "aria-pressed": String(is_in_force) });
    });
    const whole = (label, key, value, range, hint) =>
      number_row(label, value, { step: 1, ...range }, (number) => this.set({ [key]: number }), hint);
    return [
      element("h3", {}, "Quality"),
      element("div", { class: "buttons", role: "group", "aria-label": "Quality" }, ...presets),
      whole("Samples a pixel", "spp", spp, { min: 1, max: 65536 }),
      whole("Shadow rays", "n_shadow", n_shadow, { min: 0, max: 4096 }),
      gathers(integrator) ? whole("Gather rays", "n_gather", n_gather, { min: 0, max: 4096 }) : null,
      gathers(integrator) ? whole("Photons", "photons", photons, { min: 1, max: 4e9 }) : null,
      number_row("Pixel error", lod_error, { min: 0, max: 1024 }, (number) => this.set({ lod_error: number }),
        "Pixels that a voxel may cover where it stands for the mesh; 0 is the exact mesh"),
      gathers(integrator)
        ? switch_row("Smooth indirect light", this.now.filter === "on", (on) => this.set({ filter: on ? "on" : "off" }))
        : null,
    ];
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
    const fixed = ", fixed by the scene or the command";
    return [
      element("h3", {}, "Display"),
      slider_row("Exposure", this.now.exposure ?? 1, { min: 1 / 64, max: 64, least: 1e-6 },
        (exposure) => exposure > 0 && this.set({ exposure })),
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
