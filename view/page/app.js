// The page of `trex view`: what is known of the session, and who is told when it changes.
//
// ```text
// hand -> input -> camera --once an animation frame--> connection -> server
// server -> connection -> picture (frames) | state (messages) -> panels, overlay, status
// ```
// Invariants: 1. at most one camera is sent an animation frame, the latest; 2. the page sends edits only while it
// drives; 3. what lies over the picture is drawn with the camera that the picture shows, not with the newest.

import { extent, is_camera, project, same } from "./camera.js";
import { Connection } from "./connection.js";
import { Input } from "./input.js";
import { Picture } from "./picture.js";
import { Notices } from "./notices.js";
import { Panels } from "./panels.js";
import { box_in, pixel_at, size_for } from "./stage.js";
import { keep_status } from "./status.js";
import { Views } from "./views.js";
import { KIND_FILE } from "./wire.js";
import { Wishes } from "./wishes.js";

/** Keys of `welcome` and `state` that the page keeps. */
const KEPT = ["name", "role", "clients", "size", "bounds", "up", "camera", "home", "views", "lights", "light_count",
  "parts", "material", "material_count", "settings", "keys", "sides", "model", "memory", "t_max_ms", "command", "scene",
  "scene_bytes", "follows_page", "smaller", "damage", "device"];
/** Cameras kept until a picture shows them. */
const SENT_MAX = 256;
/** A window that changes its size is at rest after this, ms. */
const RESIZE_REST_MS = 180;
/** A pick that is not answered by then is given up, ms. */
const PICK_MS = 10_000;
/** What a page may not do is said once in this time, ms. */
const REFUSED_MS = 4000;
const byId = (id) => document.getElementById(id);

class App {
  constructor() {
    this.state = { lights: [], views: [], settings: {}, keys: [], role: "watch" };
    this.listeners = new Map();
    this.painters = [];
    this.sent = [];
    this.picks = new Map();
    this.wishes = new Wishes();
    this.ids = 0;
    this.link = "connecting";
    this.camera = null;
    this.shown_camera = null;
    this.camera_waits = false;
    this.rest_waits = false;
    this.size_sent = "";
    this.pixel_share = 1;
    this.stage = byId("stage");
    this.overlay = byId("overlay");
    this.notices = new Notices(byId("notices"));
    this.picture = new Picture(byId("picture"), (header) => this.drawn(header));
    this.connection = new Connection({
      state: (name) => this.linked(name),
      message: (message) => this.received(message),
      frame: (buffer) => this.framed(buffer),
      size: () => this.wanted_size(),
      frame_shown: () => this.picture.last?.frame ?? null,
    });
    this.views = new Views(this);
    this.panels = new Panels(this);
    this.input = new Input(this);
    new ResizeObserver(() => this.resized()).observe(this.stage);
    this.watch_pixels();
  }

  // What the session is, and who listens.

  /** `call(value)` whenever `key` of the state, "stats", "link" or "frame" changes. */
  listen(key, call) {
    this.listeners.set(key, [...(this.listeners.get(key) ?? []), call]);
  }

  tell(key, value) {
    for (const call of this.listeners.get(key) ?? []) {
      call(value);
    }
  }

  get drives() {
    return this.state.role === "drive" && this.connection.is_open;
  }

  get extent() {
    return extent(this.state.bounds ?? { lo: [0, 0, 0], hi: [1, 1, 1] });
  }

  linked(name) {
    this.link = name;
    this.size_sent = "";
    this.tell("link", name);
    if (name === "refused") {
      const next = "open the address that the command printed: it holds the key of this session";
      this.notices.show({ level: "error", code: "token", text: "the server does not know this page", next });
    }
  }

  received(message) {
    const { type, ...rest } = message;
    if (type === "welcome" || type === "state") {
      this.keep(rest, type === "welcome");
    } else if (type === "texts") {
      this.keep(rest, false);
    } else if (type === "stats") {
      this.state.stats = rest;
      this.tell("stats", rest);
    } else if (type === "picked") {
      this.picks.get(rest.id)?.(rest.hit);
    } else if (type === "progress" || type === "materials" || type === "waiting") {
      this.tell(type, rest);
    } else if (type === "notice") {
      this.notices.show(rest);
      this.tell("notice", rest);
    }
  }

  keep(values, is_welcome) {
    const { role = this.state.role, seq } = values;
    if (is_welcome || role !== this.state.role) {
      this.size_sent = "";
      this.wishes.forget();
    }
    const wish = { light_count: "lights" };
    const is_newer_here = (key) => role === "drive" && this.wishes.is_unknown_to(seq, wish[key] ?? key);
    const keys = KEPT.filter((key) => values[key] !== undefined && !is_newer_here(key));
    for (const key of keys) {
      this.state[key] = values[key];
    }
    // More than a message holds are not sent.
    this.state.lights ??= [];
    if (is_camera(values.camera)) {
      this.take_camera(values.camera, seq, is_welcome);
    }
    keys.forEach((key) => this.tell(key, this.state[key]));
    if (is_welcome) {
      byId("placeholder").hidden = true;
      this.tell("welcome", this.state);
    }
    if (keys.includes("size") || keys.includes("role")) {
      this.place();
      this.send_size();
    }
    if (this.state.clients === 1 && this.state.role === "watch" && (keys.includes("clients") || is_welcome)) {
      // Nobody else is there to drive.
      this.connection.send({ type: "drive" });
    }
    this.paint();
  }

  /** A camera that the server says. The hand's own is newer while this page drives. */
  take_camera(camera, seq, is_welcome) {
    const is_newer_here = this.input.is_busy || this.camera_waits || seq < this.sent.at(-1)?.seq;
    if (is_welcome || this.state.role !== "drive" || !is_newer_here) {
      this.camera = camera;
      this.shown_camera = camera;
      this.sent = [];
    }
  }

  // What the hand does.

  /** Says that this page may not do so now; true when it may. */
  may_edit() {
    if (this.drives) {
      return true;
    }
    const { is_open } = this.connection;
    const next = is_open ? "press “Take the wheel” beside the state below" : "wait for the connection";
    const text = is_open ? "this page watches: another one drives" : "there is no connection";
    const now = performance.now();
    if (!(now - this.refused_at < REFUSED_MS)) {
      this.refused_at = now;
      this.notices.show({ level: "info", code: "watching", text, next });
    }
    return false;
  }

  /** The camera from now on; sent on the next animation frame. */
  move(camera) {
    if (!is_camera(camera) || this.camera === null || !this.may_edit()) {
      return;
    }
    this.camera = camera;
    if (!this.camera_waits) {
      this.camera_waits = true;
      requestAnimationFrame(() => this.send_camera());
    }
  }

  send_camera() {
    if (this.connection.is_behind) {
      requestAnimationFrame(() => this.send_camera());
      return;
    }
    this.camera_waits = false;
    const seq = this.connection.send_event({ type: "camera", ...this.camera });
    this.sent.push({ seq, camera: this.camera });
    this.sent.splice(0, Math.max(0, this.sent.length - SENT_MAX));
    this.tell("moved", { seq, camera: this.camera });
    if (this.rest_waits) {
      this.rest();
    }
  }

  /** The hand has let go. */
  rest() {
    this.rest_waits = this.camera_waits;
    if (!this.camera_waits && this.camera !== null) {
      this.connection.send({ type: "rest" });
      this.views.rested(this.camera);
    }
  }

  /** Moves at once and lets go: a key, a view of the list. */
  jump(camera) {
    this.move(camera);
    this.rest();
  }

  /** Sends an edit; false when this page may not. */
  edit(message) {
    if (!this.may_edit()) {
      return false;
    }
    this.wishes.sent(message.type, this.connection.send_event(message));
    return true;
  }

  set_settings(settings) {
    if (this.edit({ type: "settings", settings })) {
      // Which quality that is the server says.
      Object.assign(this.state.settings, { quality: null }, settings);
      this.tell("settings", this.state.settings);
    }
  }

  /** What is known of a key of the settings: title, kind, range, choices, and the methods that use it. */
  key(name) {
    return this.state.keys.find((key) => key.name === name) ?? { name, title: name, choices: [], methods: [] };
  }

  /** Shows these lights; they are to be sent. */
  wish_lights(lights) {
    [this.state.lights, this.state.light_count] = [lights, lights.length];
    this.wishes.made("lights");
    this.paint();
  }

  set_lights(lights) {
    if (this.may_edit()) {
      this.wish_lights(lights);
      this.edit({ type: "lights", lights });
    }
  }

  next_id() {
    this.ids += 1;
    return this.ids;
  }

  /** What is seen at a place of the stage, CSS pixels; null for nothing. */
  pick(x, y) {
    const pixel = pixel_at(this.box(), this.state.size, x, y);
    const id = this.next_id();
    if (pixel === null || !this.connection.send({ type: "pick", id, pixel })) {
      return Promise.resolve(null);
    }
    return new Promise((resolve) => {
      const answered = (hit) => {
        this.picks.delete(id);
        clearTimeout(timer);
        resolve(hit ?? null);
      };
      const timer = setTimeout(() => answered(null), PICK_MS);
      this.picks.set(id, answered);
    });
  }

  // The picture and what lies over it.

  framed(buffer) {
    const is_file = buffer.byteLength > 8 && new DataView(buffer).getUint8(0) === KIND_FILE;
    if (is_file) {
      this.tell("file", buffer);
    } else if (!this.picture.take(buffer, (frame) => this.connection.send({ type: "ack", frame }))) {
      this.notices.show({ level: "error", code: "frame", text: "a frame came that is none", next: "reload the page" });
    }
  }

  drawn(header) {
    const shown = this.sent.findLast((sent) => sent.seq <= header.seq);
    if (shown) {
      this.shown_camera = shown.camera;
      this.sent = this.sent.filter((sent) => sent.seq >= shown.seq);
    }
    if (this.last_box !== `${header.width}x${header.height}`) {
      this.last_box = `${header.width}x${header.height}`;
      this.state.size = [header.width, header.height];
      this.place();
    }
    this.tell("frame", header);
    this.paint();
  }

  /** The picture's size that fits this window, device pixels. */
  wanted_size() {
    const { width, height } = this.stage.getBoundingClientRect();
    // The server says the range with its welcome, and brings what is asked for before into it.
    return size_for([width, height], window.devicePixelRatio * this.pixel_share, this.state.sides);
  }

  /** A window that moves to another screen has other pixels. */
  watch_pixels() {
    const same_pixels = matchMedia(`(resolution: ${window.devicePixelRatio}dppx)`);
    same_pixels.addEventListener("change", () => {
      this.watch_pixels();
      this.resized();
    }, { once: true });
  }

  resized() {
    this.place();
    clearTimeout(this.resize_timer);
    this.resize_timer = setTimeout(() => this.send_size(), RESIZE_REST_MS);
  }

  /** Asks for a picture of this window's size, once a size, unless the scene fixes it. */
  send_size() {
    const size = this.wanted_size();
    const text = size.join("x");
    if (this.drives && this.state.size && this.state.follows_page !== false && this.size_sent !== text) {
      this.size_sent = text;
      if (text !== this.state.size.join("x")) {
        this.connection.send_event({ type: "size", size });
      }
    }
  }

  /** Where the picture lies on the stage, CSS pixels: as large as fits. */
  box() {
    const { width, height } = this.stage.getBoundingClientRect();
    return box_in([width, height], this.state.size);
  }

  place() {
    const box = this.box();
    for (const canvas of [this.picture.canvas, this.overlay, byId("under")]) {
      for (const side of ["left", "top", "width", "height"]) {
        canvas.style[side] = `${box[side]}px`;
      }
    }
    this.overlay.width = Math.max(1, Math.round(box.width * window.devicePixelRatio));
    this.overlay.height = Math.max(1, Math.round(box.height * window.devicePixelRatio));
    this.paint();
  }

  /** Draws what lies over the picture, once an animation frame. */
  paint() {
    if (this.paint_waits || this.shown_camera === null) {
      return;
    }
    this.paint_waits = true;
    requestAnimationFrame(() => {
      this.paint_waits = false;
      const { width, height } = this.box();
      const context = this.overlay.getContext("2d");
      const ratio = this.overlay.width / Math.max(1, width);
      context.setTransform(1, 0, 0, 1, 0, 0);
      context.clearRect(0, 0, this.overlay.width, this.overlay.height);
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
      const place = (point) => project(this.shown_camera, [width, height], point);
      this.painters.forEach((painter) => painter(context, place, [width, height]));
    });
  }
}

/** What tests and measurements read. */
function publish(app) {
  window.trex = {
    app,
    same,
    get drawn() { return app.picture.marks.drawn; },
    get failed() { return app.picture.marks.failed; },
    get last() { return app.picture.last; },
    get times() { return app.picture.marks.times; },
    get seq() { return app.connection.seq; },
    get link() { return document.body.dataset.link; },
    get counts() { return app.connection.counts; },
  };
}

const app = new App();
keep_status(app);
publish(app);
app.place();
app.connection.open();
