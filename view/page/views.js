// Views: those of the scene, bookmarks, the ones before, and the one in the address.
//
// Invariants: 1. the history ends with the view at rest, HISTORY_MAX long at most; 2. bookmarks are kept in this
// browser, by the model's name; 3. the address always holds the view at rest, and opens it again.

import { from_text, is_camera, numbered, roll, same, to_text } from "./camera.js";
import { fragment, replace_fragment } from "./connection.js";
import { button, element, row } from "./widgets.js";

const HISTORY_MAX = 200;
const BOOKMARKS_MAX = 100;
const SIDES = [["front", "Front"], ["right", "Right"], ["top", "Top"], ["isometric", "Corner"]];

export class Views {
  constructor(app) {
    this.app = app;
    this.history = [];
    this.at = -1;
    this.scene_at = -1;
    this.has_opened = false;
    app.listen("welcome", () => this.welcomed());
    window.addEventListener("hashchange", () => {
      app.connection.renew();
      this.open_address();
    });
  }

  welcomed() {
    if (!this.has_opened) {
      this.has_opened = true;
      this.rested(this.app.camera, false);
      this.open_address();
    }
  }

  /** Goes to the view that the address holds, if it holds one. */
  open_address() {
    const camera = from_text(fragment().get("view"));
    if (camera !== null && this.app.camera !== null && !same(camera, this.app.camera)) {
      this.app.jump(camera);
    }
  }

  /** A view at rest: the next one of the history, and the address's. */
  rested(camera, in_address = true) {
    if (this.at < 0 || !same(this.history[this.at], camera)) {
      this.history = [...this.history.slice(0, this.at + 1), camera].slice(-HISTORY_MAX);
      this.at = this.history.length - 1;
    }
    if (in_address) {
      const parameters = fragment();
      parameters.set("view", to_text(camera));
      replace_fragment(parameters);
    }
  }

  /** The view `by` steps on in the history. */
  step(by) {
    const camera = this.history[this.at + by];
    if (camera && this.app.may_edit()) {
      this.at += by;
      this.app.jump(camera);
    }
  }

  reset() {
    this.app.jump(this.app.state.home);
  }

  go(name) {
    const { camera, state } = this.app;
    const { width, height } = this.app.box();
    this.app.jump(numbered(name, camera, state.bounds, state.up, width / height));
  }

  roll(quarter) {
    this.app.jump(roll(this.app.camera, (quarter * Math.PI) / 2));
  }

  next_camera() {
    const { views } = this.app.state;
    if (views.length > 0) {
      this.scene_at = (this.scene_at + 1) % views.length;
      this.app.jump(views[this.scene_at]);
    } else {
      this.app.notices.info("the scene has no further cameras", "press B to keep a view of your own");
    }
  }

  // Bookmarks.

  get key() {
    return `trex-bookmarks ${this.app.state.name}`;
  }

  bookmarks() {
    try {
      const kept = JSON.parse(localStorage.getItem(this.key) ?? "[]");
      return Array.isArray(kept) ? kept.filter((mark) => is_camera(mark?.camera)).slice(0, BOOKMARKS_MAX) : [];
    } catch {
      return [];
    }
  }

  /** False, and said, where the browser keeps nothing: its store is full, or closed to this page. */
  keep_bookmarks(marks) {
    try {
      localStorage.setItem(this.key, JSON.stringify(marks.slice(-BOOKMARKS_MAX)));
    } catch (error) {
      this.app.notices.show({ level: "error", text: "the browser does not keep the views of this model",
        place: this.key, numbers: String(error?.name ?? error),
        next: "let it store data of this page, or copy the link, which holds the view" });
      return false;
    }
    this.app.panels.refresh("views");
    return true;
  }

  bookmark() {
    const marks = this.bookmarks();
    const numbers = marks.map((mark) => Number(/^View (\d+)$/.exec(mark.name)?.[1] ?? 0));
    const name = `View ${Math.max(0, ...numbers) + 1}`;
    if (this.keep_bookmarks([...marks, { name, camera: this.app.camera }])) {
      this.app.notices.info(`kept as “${name}”`);
    }
  }

  /** The panel. */
  panel() {
    const { app } = this;
    const sides = SIDES.map(([name, text]) => button(text, () => this.go(name)));
    const scene = app.state.views.map((camera, at) => button(`Camera ${at + 1}`, () => app.jump(camera)));
    const marks = this.bookmarks().map((mark, at) => this.bookmark_row(mark, at));
    const angle = app.camera?.fov_y.toFixed(2);
    const fov = element("input", { type: "number", min: 1, max: 170, step: "any", value: angle });
    fov.addEventListener("change", () => {
      if (fov.checkValidity() && fov.value !== "") {
        app.jump({ ...app.camera, fov_y: Number(fov.value) });
      }
    });
    return [
      element("div", { class: "buttons" }, button("First view", () => this.reset()), ...sides),
      element("div", { class: "buttons" },
        button("Before", () => this.step(-1), { title: "Backspace" }),
        button("After", () => this.step(1), { title: "Shift + Backspace" })),
      row("Angle of view, degrees", fov),
      element("h3", {}, "Cameras of the scene"),
      scene.length ? element("div", { class: "buttons" }, ...scene) : element("p", { class: "hint" }, "None."),
      element("h3", {}, "Bookmarks"),
      element("ul", { class: "list" }, ...marks),
      element("div", { class: "buttons" }, button("Keep this view", () => this.bookmark())),
    ];
  }

  bookmark_row(mark, at) {
    const others = () => this.bookmarks().filter((_, other) => other !== at);
    const rename = (event) => {
      const marks = this.bookmarks();
      marks[at].name = event.target.value.slice(0, 80) || mark.name;
      this.keep_bookmarks(marks);
    };
    return element("li", {},
      button("Go", () => this.app.jump(mark.camera), { "aria-label": `Go to ${mark.name}` }),
      element("input", { value: mark.name, "aria-label": "Name of the bookmark", maxlength: 80, change: rename }),
      button("×", () => this.keep_bookmarks(others()), { class: "quiet", "aria-label": `Forget ${mark.name}` }));
  }
}
