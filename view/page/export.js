// The panel to save and share: links, the command line, the scene's text, and pictures rendered by the server.
//
// Invariants: 1. the texts are the server's own; 2. one picture is under way at a time; 3. a file becomes a download
// by a blob's address, which is given back.

import { to_text } from "./camera.js";
import { button, bytes, choice_row, element, number_row, row } from "./widgets.js";
import { FILE_EXR, FILE_HEAD_BYTES, FILE_PNG, FILE_SCENE } from "./wire.js";

const FORMATS = [["png", "PNG"], ["exr", "EXR: linear light"]];
/** Endings and media types of files, by the number that the server gives them. */
const FILES = {
  [FILE_PNG]: ["png", "image/png"],
  [FILE_EXR]: ["exr", "image/x-exr"],
  [FILE_SCENE]: ["toml", "application/toml"],
};
/** A blob's address lives this long, ms: the download has begun by then. */
const ADDRESS_MS = 60_000;

export class Export {
  constructor(app) {
    this.app = app;
    this.format = "png";
    this.size = null;
    this.spp = null;
    this.under_way = null;
    app.listen("progress", (progress) => this.progressed(progress));
    app.listen("file", (buffer) => this.received(buffer));
    app.listen("link", () => this.ended());
    app.listen("notice", ({ code }) => code === "screenshot" && this.ended());
  }

  async copy(text, what) {
    try {
      await navigator.clipboard.writeText(text);
      this.app.panels.say(`Copied: ${what}`);
    } catch {
      const next = "select the text in this panel and copy it by hand";
      this.app.notices.show({ level: "error", code: "clipboard", text: "the browser lets no page copy here", next });
    }
  }

  get link() {
    const { camera, connection } = this.app;
    const view = to_text(camera);
    return `${location.origin}${location.pathname}#token=${connection.token}&view=${view}`;
  }

  copy_link() {
    this.copy(this.link, "link to this view");
  }

  /** Asks for a picture. */
  take(format, size, spp) {
    const { app } = this;
    if (this.under_way !== null || !app.may_edit()) {
      return;
    }
    const id = app.next_id();
    if (app.connection.send({ type: "screenshot", id, format, size, spp })) {
      this.under_way = { id, done: 0, total: 0 };
      app.panels.say("The picture is being rendered");
      app.panels.refresh("export");
    }
  }

  /** A PNG of what is shown, at its size. */
  quick() {
    this.take("png", this.app.state.size, this.app.state.settings.spp ?? 16);
  }

  /** Asks for no picture, after all; the server answers with a notice. */
  cancel() {
    if (this.under_way !== null) {
      this.app.connection.send({ type: "cancel", id: this.under_way.id });
    }
  }

  progressed({ id, done, total }) {
    if (this.under_way?.id === id) {
      Object.assign(this.under_way, { done, total });
      const bar = document.querySelector("#panel-body progress");
      if (bar !== null) {
        [bar.max, bar.value] = [Math.max(1, total), done];
      }
    }
  }

  received(buffer) {
    const view = new DataView(buffer);
    const [[format, type], id] = [FILES[view.getUint8(1)] ?? FILES[FILE_PNG], view.getUint32(4, true)];
    if (format !== "toml" && this.under_way?.id !== id) {
      return;
    }
    if (format !== "toml") {
      this.ended();
    }
    const address = URL.createObjectURL(new Blob([new Uint8Array(buffer, FILE_HEAD_BYTES)], { type }));
    const stem = String(this.app.state.name ?? "picture").replace(/\.[^.]*$/, "").replace(/[^\w.-]+/g, "-");
    element("a", { href: address, download: `${stem || "picture"}.${format}` }).click();
    setTimeout(() => URL.revokeObjectURL(address), ADDRESS_MS);
    this.app.tell("saved", { format, byte_count: buffer.byteLength - FILE_HEAD_BYTES });
  }

  ended() {
    this.under_way = null;
    this.app.panels?.refresh("export");
  }

  /** The panel. */
  panel() {
    const { state } = this.app;
    return [
      element("h3", {}, "This view"),
      this.text("Link", this.app.camera ? this.link : "", "link to this view", 2),
      this.text("Command line", state.command ?? "", "command line", 4),
      ...this.scene(),
      element("h3", {}, "Picture"),
      ...this.picture(),
    ];
  }

  /** The scene's text; a long one is saved, not shown. */
  scene() {
    const { scene, scene_bytes } = this.app.state;
    if (scene !== null || !scene_bytes) {
      return [this.text("Scene file", scene ?? "", "scene file", 8)];
    }
    const ask = () => this.app.connection.send({ type: "scene", id: this.app.next_id() });
    return [
      element("p", { class: "hint" }, `The scene file has ${bytes(scene_bytes)}: too long to be shown here.`),
      element("div", { class: "buttons" }, button("Save the scene file", ask)),
    ];
  }

  text(label, text, what, lines) {
    const area = element("textarea", { readonly: true, rows: lines, spellcheck: "false", wrap: "soft" });
    area.value = text;
    const made = row(label, area);
    made.classList.add("text");
    made.insertBefore(button("Copy", () => this.copy(area.value, what), { "aria-label": `Copy the ${what}` }), area);
    return made;
  }

  picture() {
    const { app } = this;
    const size = this.size ?? app.state.size ?? [1280, 720];
    const spp = this.spp ?? app.state.settings.spp ?? 16;
    const side = (at) => (value) => {
      this.size = [...size];
      this.size[at] = value;
      size[at] = value;
    };
    const [sides, samples] = ["resolution", "spp"].map((name) => app.key(name));
    const take = () => this.take(this.format, this.size ?? app.state.size, this.spp ?? spp);
    const done = this.under_way;
    return [
      choice_row("Format", this.format, FORMATS, (format) => { this.format = format; }),
      number_row("Width", size[0], { ...sides, step: 1 }, side(0)),
      number_row("Height", size[1], { ...sides, step: 1 }, side(1)),
      number_row(samples.title, spp, { ...samples, step: 1 }, (value) => { this.spp = value; }),
      element("div", { class: "buttons" }, button("Render and save", take, { disabled: done !== null }),
        done ? button("Cancel", () => this.cancel()) : null),
      done ? element("p", { class: "hint" }, "Changes of the view wait until it is done.") : null,
      done ? element("progress", { max: Math.max(1, done.total), value: done.done, "aria-label": "Picture" }) : null,
    ];
  }
}
