// The panels beside the picture: which one is open, the tool in hand, and the actions that keys share with buttons.
//
// Invariants: 1. at most one panel is open; 2. a panel is built anew when what it shows has changed and no field of it
// has the keys; 3. Escape ends, in this order: the tool, the help, the panel.

import { Export } from "./export.js";
import { Handles } from "./handles.js";
import { Help } from "./help.js";
import { Lights } from "./lights.js";
import { Materials } from "./materials.js";
import { Measure } from "./measure.js";
import { Parts } from "./parts.js";
import { SectionHandles } from "./section_handles.js";
import { Settings } from "./settings.js";
import { Statistics } from "./statistics.js";

const TITLES = {
  views: "Views",
  lights: "Lights",
  materials: "Materials",
  parts: "Sections and parts",
  measure: "Pick and measure",
  settings: "Picture",
  statistics: "Statistics",
  export: "Save and share",
};
/** State keys whose change makes a panel anew. */
const SHOWS = {
  views: ["views"],
  lights: ["lights"],
  materials: ["parts"],
  parts: ["parts"],
  measure: [],
  settings: ["settings", "memory", "size"],
  statistics: ["model", "damage"],
  export: ["command", "scene"],
};
/** Time that what is said in passing stays, ms. */
const SAID_MS = 1600;
const OPEN_KEY = "trex-panel";
const byId = (id) => document.getElementById(id);

export class Panels {
  constructor(app) {
    this.app = app;
    this.open_name = null;
    this.tool = null;
    this.handles = new Handles(app);
    this.measure = new Measure(app, this);
    this.parts = new Parts(app, this);
    this.section_handles = new SectionHandles(app, this);
    this.materials = new Materials(app, this);
    this.help = new Help(byId("help"));
    this.settings = new Settings(app);
    this.export = new Export(app);
    this.content = {
      views: app.views,
      lights: new Lights(app, this.handles),
      materials: this.materials,
      parts: this.parts,
      measure: this.measure,
      settings: this.settings,
      statistics: new Statistics(app),
      export: this.export,
    };
    for (const tab of document.querySelectorAll("#tools button[data-panel]")) {
      tab.addEventListener("click", () => this.toggle(tab.dataset.panel));
    }
    byId("help-open").addEventListener("click", () => this.help.toggle());
    byId("panel-close").addEventListener("click", () => this.close());
    for (const [name, keys] of Object.entries(SHOWS)) {
      keys.forEach((key) => app.listen(key, () => this.refresh(name)));
    }
    app.listen("welcome", () => this.reopen());
  }

  /** Opens the panel that an earlier load of the page had open. */
  reopen() {
    const name = sessionStorage.getItem(OPEN_KEY);
    if (this.open_name === null && name !== null && this.content[name]) {
      this.open(name, false);
    }
  }

  /** The handle at a place of the picture as what a drag moves; null for none. */
  grab(at) {
    return this.section_handles.grab(at) ?? this.handles.grab(at);
  }

  /** The pointer is at a place of the picture. */
  hover(at) {
    this.handles.hover(at);
    document.body.classList.toggle("on-handle", this.handles.hovered >= 0 || this.section_handles.is_on(at));
  }

  toggle(name) {
    if (this.open_name === name) {
      this.close();
    } else {
      this.open(name);
    }
  }

  open(name, takes_focus = true) {
    this.content[this.open_name]?.closed?.();
    this.open_name = name;
    sessionStorage.setItem(OPEN_KEY, name);
    byId("panel").hidden = false;
    byId("panel-title").textContent = TITLES[name];
    this.build();
    this.mark_tabs();
    if (takes_focus) {
      byId("panel-title").focus({ preventScroll: true });
    }
    this.app.paint();
  }

  close() {
    const tab = document.querySelector(`#tools button[data-panel="${this.open_name}"]`);
    this.content[this.open_name]?.closed?.();
    const had_focus = byId("panel").contains(document.activeElement);
    this.open_name = null;
    sessionStorage.removeItem(OPEN_KEY);
    byId("panel").hidden = true;
    byId("panel-body").replaceChildren();
    this.mark_tabs();
    if (had_focus) {
      tab?.focus();
    }
    this.app.paint();
  }

  mark_tabs() {
    for (const tab of document.querySelectorAll("#tools button[data-panel]")) {
      tab.setAttribute("aria-expanded", String(tab.dataset.panel === this.open_name));
    }
  }

  build() {
    byId("panel-body").replaceChildren(...this.content[this.open_name].panel().filter((child) => child !== null));
  }

  /** Builds the panel `name` anew if it is open, unless the hand is in one of its fields. */
  refresh(name) {
    const active = document.activeElement;
    const is_in_use = byId("panel-body").contains(active) && ["INPUT", "SELECT", "TEXTAREA"].includes(active.tagName);
    if (this.open_name === name && !is_in_use) {
      this.rebuild();
    }
  }

  /** Builds the open panel anew; the keys stay at the same place of it. */
  rebuild() {
    if (this.open_name === null) {
      return;
    }
    const body = byId("panel-body");
    const focusable = () => [...body.querySelectorAll("button, input, select, textarea, summary")];
    const at = focusable().indexOf(document.activeElement);
    const { scrollTop } = body;
    this.build();
    body.scrollTop = scrollTop;
    if (at >= 0) {
      focusable()[Math.min(at, focusable().length - 1)]?.focus({ preventScroll: true });
    }
  }

  /** Says something in passing, over the lower edge of the picture. */
  say(text) {
    const said = byId("said");
    said.textContent = text;
    clearTimeout(this.said_timer);
    this.said_timer = setTimeout(() => { said.textContent = ""; }, SAID_MS);
  }

  // Tools: what the next click on the picture does.

  take(tool) {
    this.tool = this.tool === tool ? null : tool;
    document.body.dataset.tool = this.tool ?? "";
    this.measure.tool_changed(this.tool);
    this.refresh(this.open_name);
  }

  /** A click that picks, at a place of the stage. */
  async clicked(x, y) {
    const { tool } = this;
    const hit = await this.app.pick(x, y);
    if (tool === "measure") {
      this.measure.point(hit);
    } else if (tool === "hide") {
      this.parts.hit(hit);
    } else {
      if (tool === "pick") {
        this.take(null);
      }
      this.picked(hit);
    }
  }

  /** Shows what was picked: its material where that panel is open, else where it lies. */
  picked(hit) {
    this.measure.picked(hit);
    if (hit === null) {
      this.say("Nothing is there");
      return;
    }
    this.materials.select(hit.material);
    if (this.open_name !== "materials") {
      this.open("measure", false);
    }
  }

  /** Does what a key stands for; false when it stands for nothing here. */
  act(name, at) {
    const actions = {
      pick: () => this.clicked(...at),
      hide: async () => this.parts.hit(await this.app.pick(...at)),
      measure: () => {
        this.open("measure", false);
        this.take("measure");
      },
      brighter: () => this.content.lights.stronger(1.1),
      darker: () => this.content.lights.stronger(1 / 1.1),
      handles: () => this.handles.toggle(),
      debug: () => this.settings.next_debug(),
      screenshot: () => this.export.quick(),
      copy_link: () => this.export.copy_link(),
      statistics: () => this.toggle("statistics"),
      bare: () => document.body.classList.toggle("bare"),
      help: () => this.help.toggle(),
      escape: () => this.escape(),
    };
    actions[name]?.();
    return actions[name] !== undefined;
  }

  escape() {
    if (this.tool !== null) {
      this.take(null);
    } else if (this.help.is_open) {
      this.help.toggle();
    } else if (document.body.classList.contains("bare")) {
      document.body.classList.remove("bare");
    } else if (this.open_name !== null) {
      this.close();
    }
  }
}
