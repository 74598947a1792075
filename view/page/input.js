// The hand: pointers, wheel, touch and keys become cameras and actions.
//
// ```text
// one pointer:  left turns, right | middle | shift shifts, Ctrl picks; with a flying key held, left looks around
// two pointers: their middle shifts, their distance comes nearer
// ```
// Invariants: 1. a drag that begins on a handle moves the handle, else the view; 2. each movement ends with `rest`.

import { fly, look, look_at, orbit, pan, zoom } from "./camera.js";
import { FLIGHT, action_of } from "./keys.js";

/** A wheel's notch is about 100 pixels: it comes nearer by a tenth. */
const ZOOM_PER_PIXEL = 0.001;
const ZOOM_PER_KEY = 0.85;
/** Pixels of a line and of a page, for wheels that count so. */
const WHEEL_PIXELS = [1, 16, 400];
/** Without a further notch the wheel rests, ms. */
const WHEEL_REST_MS = 160;
/** Pixels that a click may move. */
const CLICK_PIXELS = 4;
/** Share of the model's extent that is flown in a second at speed 1. */
const FLIGHT_PER_S = 0.25;
const SPEED_RANGE = [1e-6, 1e4];
/** An arrow key turns as a drag of so many pixels. */
const ARROW_PIXELS = 24;

export class Input {
  constructor(app) {
    this.app = app;
    this.pointers = new Map();
    this.drag = null;
    this.held = new Set();
    this.is_flying = false;
    this.speed = 1;
    this.at = [0, 0];
    const { stage } = app;
    stage.addEventListener("pointerdown", (event) => this.down(event));
    stage.addEventListener("pointermove", (event) => this.moved(event));
    stage.addEventListener("pointerup", (event) => this.up(event));
    stage.addEventListener("pointercancel", (event) => this.up(event));
    stage.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    stage.addEventListener("dblclick", (event) => this.focus(...this.place(event)));
    stage.addEventListener("contextmenu", (event) => event.preventDefault());
    window.addEventListener("keydown", (event) => this.key_down(event));
    window.addEventListener("keyup", (event) => this.key_up(event));
    window.addEventListener("blur", () => this.release());
  }

  /** True while the hand is on the view. */
  get is_busy() {
    return this.drag !== null || this.held.size > 0 || this.wheel_timer !== undefined;
  }

  place(event) {
    const { left, top } = this.app.stage.getBoundingClientRect();
    return [event.clientX - left, event.clientY - top];
  }

  /** The picture's size on the stage, and a place of the stage in it. */
  in_picture(x, y) {
    const box = this.app.box();
    return { size: [box.width, box.height], x: x - box.left, y: y - box.top };
  }

  down(event) {
    const [x, y] = this.place(event);
    this.app.stage.focus({ preventScroll: true });
    this.app.stage.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [x, y]);
    this.at = [x, y];
    if (this.pointers.size > 1) {
      this.drag = { kind: "pinch", has_moved: true };
      return;
    }
    const picks = event.button === 0 && (event.ctrlKey || event.metaKey || this.app.panels.tool !== null);
    const handle = event.button === 0 && !picks ? this.app.panels.grab(this.in_picture(x, y)) : null;
    const shifts = event.button !== 0 || event.shiftKey;
    const kind = handle ? "handle" : picks ? "pick" : shifts ? "pan" : "orbit";
    this.drag = { kind, from: [x, y], has_moved: false, handle };
  }

  moved(event) {
    const before = this.pointers.get(event.pointerId);
    const [x, y] = this.place(event);
    this.at = [x, y];
    if (before === undefined || this.drag === null) {
      this.app.panels.hover(this.in_picture(x, y));
      return;
    }
    const others = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
    this.pointers.set(event.pointerId, [x, y]);
    const [dx, dy] = [x - before[0], y - before[1]];
    if (this.drag.kind === "pinch" && others.length > 0) {
      this.pinch(before, [x, y], others[0]);
      return;
    }
    const { from, kind } = this.drag;
    const is_view = kind === "orbit" || kind === "pan";
    this.drag.has_moved ||= is_view || Math.hypot(x - from[0], y - from[1]) >= CLICK_PIXELS;
    this.dragged(dx, dy);
  }

  dragged(dx, dy) {
    const { app, drag } = this;
    const { size } = this.in_picture(0, 0);
    if (app.camera === null) {
      return;
    }
    if (drag.kind === "handle") {
      drag.handle.drag(dx, dy, size);
    } else if (drag.kind === "pan") {
      app.move(pan(app.camera, size, dx, dy));
    } else if (drag.kind === "orbit") {
      const turn = this.held.size > 0 ? look : orbit;
      app.move(turn(app.camera, size[1], dx, dy));
    }
  }

  pinch(before, now, other) {
    const { app } = this;
    const [dx, dy] = [(now[0] - before[0]) / 2, (now[1] - before[1]) / 2];
    const apart = (place) => Math.max(8, Math.hypot(place[0] - other[0], place[1] - other[1]));
    const { size, x, y } = this.in_picture((now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
    if (app.camera !== null) {
      const shifted = pan(app.camera, size, dx, dy);
      app.move(zoom(shifted, size, app.extent, apart(before) / apart(now), x, y));
    }
  }

  up(event) {
    if (!this.pointers.delete(event.pointerId) || this.drag === null) {
      return;
    }
    if (this.pointers.size > 0) {
      // One of two fingers is left: it turns on.
      this.drag = { kind: "orbit", from: [...this.pointers.values()][0], has_moved: true };
      return;
    }
    const { kind, has_moved, handle } = this.drag;
    this.drag = null;
    if (kind === "handle") {
      handle.drop(has_moved);
    } else if (kind === "pick" && event.type !== "pointercancel") {
      this.app.panels.clicked(...this.place(event));
    } else if (has_moved) {
      this.app.rest();
    }
  }

  wheel(event) {
    event.preventDefault();
    const { app } = this;
    const amount = (event.deltaY || event.deltaX) * (WHEEL_PIXELS[event.deltaMode] ?? 1);
    const factor = Math.exp(Math.max(-500, Math.min(500, amount)) * ZOOM_PER_PIXEL);
    if (event.shiftKey) {
      this.speed = Math.max(SPEED_RANGE[0], Math.min(SPEED_RANGE[1], this.speed / factor ** 2));
      app.panels.say(`Flying at ${this.speed.toPrecision(2)} times the usual speed`);
      return;
    }
    this.zoom_by(factor, ...this.place(event));
    clearTimeout(this.wheel_timer);
    this.wheel_timer = setTimeout(() => {
      this.wheel_timer = undefined;
      app.rest();
    }, WHEEL_REST_MS);
  }

  zoom_by(factor, left, top) {
    const { app } = this;
    const { size, x, y } = this.in_picture(left, top);
    if (app.camera !== null) {
      app.move(zoom(app.camera, size, app.extent, factor, x, y));
    }
  }

  /** Makes what is seen at a place the point that the view turns about. */
  async focus(x, y) {
    const hit = await this.app.pick(x, y);
    if (hit) {
      this.app.jump(look_at(this.app.camera, hit.position));
    }
  }

  // Keys.

  key_down(event) {
    const tag = event.target.closest?.("input, select, textarea, button, dialog, summary")?.tagName;
    if (tag !== undefined && !(tag === "BUTTON" && !["Enter", " "].includes(event.key)) && event.key !== "Escape") {
      return;
    }
    if (FLIGHT[event.code] && !event.ctrlKey && !event.metaKey && !event.altKey && !event.shiftKey) {
      event.preventDefault();
      this.hold(event.code);
      return;
    }
    const action = action_of(event);
    // Text that is selected is what is copied.
    const is_text = action === "copy_link" && String(window.getSelection()) !== "";
    if (action !== undefined && !is_text && this.act(action)) {
      event.preventDefault();
    }
  }

  key_up(event) {
    if (this.held.delete(event.code) && this.held.size === 0) {
      this.app.rest();
    }
  }

  /** The window has lost the keys: none is held any more. */
  release() {
    if (this.held.size > 0) {
      this.held.clear();
      this.app.rest();
    }
  }

  /** One flight for all keys that are held, also for one that comes back within a frame. */
  hold(code) {
    this.held.add(code);
    if (this.is_flying) {
      return;
    }
    this.is_flying = true;
    let before = performance.now();
    const step = (now) => {
      this.is_flying = this.held.size > 0 && this.app.camera !== null;
      if (this.is_flying) {
        this.fly(Math.max(0, Math.min(0.1, (now - before) / 1000)));
        before = now;
        requestAnimationFrame(step);
      }
    };
    requestAnimationFrame(step);
  }

  fly(seconds) {
    const way = [0, 0, 0];
    for (const code of this.held) {
      FLIGHT[code].forEach((part, axis) => { way[axis] += part; });
    }
    const far = this.speed * FLIGHT_PER_S * this.app.extent * seconds;
    this.app.move(fly(this.app.camera, way.map((part) => part * far)));
  }

  /** Does what a key stands for; false when it is nothing of the view or the panels. */
  act(name) {
    const { app } = this;
    if (app.camera === null) {
      return app.panels.act(name, this.at);
    }
    const { size } = this.in_picture(0, 0);
    const middle = [app.stage.clientWidth / 2, app.stage.clientHeight / 2];
    const turn = (dx, dy) => app.jump(orbit(app.camera, size[1], dx * ARROW_PIXELS, dy * ARROW_PIXELS));
    const near = (factor) => {
      this.zoom_by(factor, ...middle);
      app.rest();
    };
    const actions = {
      reset: () => app.views.reset(),
      front: () => app.views.go("front"),
      right: () => app.views.go("right"),
      top: () => app.views.go("top"),
      isometric: () => app.views.go("isometric"),
      roll_left: () => app.views.roll(-1),
      roll_right: () => app.views.roll(1),
      next_camera: () => app.views.next_camera(),
      undo: () => app.views.step(-1),
      redo: () => app.views.step(1),
      bookmark: () => app.views.bookmark(),
      focus: () => this.focus(...this.at),
      nearer: () => near(ZOOM_PER_KEY),
      farther: () => near(1 / ZOOM_PER_KEY),
      turn_left: () => turn(1, 0),
      turn_right: () => turn(-1, 0),
      turn_up: () => turn(0, 1),
      turn_down: () => turn(0, -1),
    };
    if (actions[name] === undefined) {
      return app.panels.act(name, this.at);
    }
    actions[name]();
    return true;
  }
}
