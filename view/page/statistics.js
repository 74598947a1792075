// The panel of the statistics: every number that the system promises, as it is now, with small plots; and the pages of
// the file that are damaged.
//
// Invariants: 1. what the server does not say is not shown; 2. plots go on while the panel is closed, so that it opens
// with what has been.

import { Plot } from "./plot.js";
import { bytes, element, short } from "./widgets.js";

/** A time in ms, below ten with a tenth. */
export const milliseconds = (number) =>
  (Number.isFinite(number) ? `${number < 9.95 ? number.toFixed(1) : Math.round(number)} ms` : "-");
/** Rows with a plot: [key, label, value of the statistics, text, limit]. */
const PLOTS = [
  ["memory", "Memory", (s) => s.memory?.used_bytes, bytes, (s) => s.memory?.limit_bytes],
  ["fps", "Pictures/s", (s) => s.fps, (x) => x.toFixed(1)],
  ["rate", "Bytes/s", (s) => s.bytes_per_s, bytes],
  ["rays", "Rays/s", (s) => sum(s.rays_per_s), short],
  ["misses", "Page misses/s", (s) => s.misses_per_s, short],
  ["error", "Pixel error", (s) => s.pixel_error?.in_force, (x) => `${Number(x.toPrecision(3))} px`,
    (s) => s.pixel_error?.asked],
];

/** Rows of text by heading: [label, text of the statistics and the state of the session, or undefined]. */
const FACTS = [
  ["Picture", [
    ["Samples", (s) => given(s.samples, (x) => `${x} of ${s.spp}`)],
    ["Light that has come", (s) => given(s.light_share, (x) => `${Math.round(100 * x)} %`)],
    ["Pixel error asked", (s) => given(s.pixel_error?.asked, (x) => `${Number(x.toPrecision(3))} px`)],
    ["Sent so far", (s) => given(s.sent_bytes, bytes)],
  ]],
  ["Times after an event", [
    ["First", (s) => given(s.times_ms?.first, milliseconds)],
    ["Whole", (s) => given(s.times_ms?.whole, milliseconds)],
    ["Response", (s) => given(s.times_ms?.response, milliseconds)],
    ["Complete", (s) => given(s.times_ms?.complete, milliseconds)],
  ]],
  ["Rays a second", ["primary", "shadow", "gather", "far", "photon"].map((kind) =>
    [kind[0].toUpperCase() + kind.slice(1), (s) => given(s.rays_per_s?.[kind], short)])],
  ["Memory", [
    ["Limit", (s) => given(s.memory?.limit_bytes, bytes)],
    ["In frames of the pool", (s) => given(s.memory?.frames_bytes, bytes)],
    ["Greatest of the process", (s) => given(s.memory?.peak_rss_bytes, bytes)],
  ]],
  ["Pool of pages", [
    ["Frames", (s) => given(s.pool?.frames, short)],
    ["Pages in them", (s) => given(s.pool?.resident, short)],
    ["Pages read", (s) => given(s.pool?.pages_read, short)],
    ["Look-ups that found their page missing", (s) => given(s.pool?.misses, short)],
    ["Evictions", (s) => given(s.pool?.evictions, short)],
    ["Bytes read", (s) => given(s.pool?.bytes_read, bytes)],
  ]],
  ["Rays through the voxels", [
    ["Answered by", (s, state) => state.device],
    ["Answered on the device", (s) => given(s.gpu?.rays, short)],
    ["Answered by the processor in its place", (s) => given(s.gpu?.processor_rays, short)],
    ["Sent to it", (s) => given(s.gpu?.uploaded_bytes, bytes)],
    ["Sent back", (s) => given(s.gpu?.read_back_bytes, bytes)],
    ["Pages of finer voxels sent", (s) => given(s.gpu?.unit_uploads, short)],
    ["Of these, that gave way", (s) => given(s.gpu?.unit_evictions, short)],
    ["Video memory", (s) => given(s.gpu?.memory_used_bytes, bytes)],
    ["Its limit", (s) => given(s.gpu?.memory_limit_bytes, bytes)],
  ]],
];

const given = (value, text) => (Number.isFinite(value) ? text(value) : undefined);
const sum = (kinds) => (kinds ? Object.values(kinds).reduce((all, one) => all + (one || 0), 0) : undefined);

export class Statistics {
  constructor(app) {
    this.app = app;
    this.plots = new Map(PLOTS.map(([key, label]) => [key, new Plot(label)]));
    this.texts = new Map();
    this.before = null;
    app.listen("stats", (stats) => this.take(stats));
  }

  take(stats) {
    const now = performance.now();
    const misses = stats.pool?.misses;
    if (this.before !== null && Number.isFinite(misses)) {
      const seconds = Math.max(0.05, (now - this.before.now) / 1000);
      stats.misses_per_s = Math.max(0, misses - this.before.misses) / seconds;
    }
    this.before = Number.isFinite(misses) ? { now, misses } : null;
    for (const [key, , value, , limit] of PLOTS) {
      const number = value(stats);
      if (Number.isFinite(number)) {
        this.plots.get(key).add(number, limit?.(stats) ?? null);
      }
    }
    this.fill(stats);
  }

  /** The panel. */
  panel() {
    this.texts.clear();
    const stats = this.app.state.stats ?? {};
    const plots = PLOTS.map(([key, label]) => {
      const text = element("span", { class: "value" }, "-");
      this.texts.set(`plot ${key}`, text);
      return element("div", { class: "plot-row" }, element("span", {}, label), this.plots.get(key).canvas, text);
    });
    const tables = FACTS.flatMap(([heading, rows]) => {
      const parts = rows.flatMap(([label]) => {
        const text = element("dd", {}, "-");
        this.texts.set(`${heading} ${label}`, text);
        return [element("dt", {}, label), text];
      });
      return [element("h3", {}, heading), element("dl", { class: "facts" }, ...parts)];
    });
    requestAnimationFrame(() => this.plots.forEach((plot) => plot.draw()));
    queueMicrotask(() => this.fill(stats));
    return [...damage_list(this.app.state.damage), ...plots, ...tables, ...this.model()];
  }

  /** What the model says of itself. */
  model() {
    const rows = Object.entries(this.app.state.model ?? {})
      .filter(([, value]) => ["number", "string", "boolean"].includes(typeof value));
    const number = (key, value) => (key.endsWith("_bytes") ? bytes(value) : short(value));
    const text = (key, value) => (typeof value === "number" ? number(key, value) : String(value));
    const name = (key) => (key[0].toUpperCase() + key.slice(1)).replace(/_bytes$/, "").replaceAll("_", " ");
    const parts = rows.flatMap(([key, value]) => [element("dt", {}, name(key)), element("dd", {}, text(key, value))]);
    return parts.length > 0 ? [element("h3", {}, "Model"), element("dl", { class: "facts" }, ...parts)] : [];
  }

  fill(stats) {
    const put = (key, text) => {
      const place = this.texts.get(key);
      if (place !== undefined) {
        place.textContent = text ?? "-";
      }
    };
    for (const [key, , value, text] of PLOTS) {
      put(`plot ${key}`, given(value(stats), text));
    }
    for (const [heading, rows] of FACTS) {
      rows.forEach(([label, text]) => put(`${heading} ${label}`, text(stats, this.app.state)));
    }
  }
}

/** The pages of the file that are damaged: how many, and of the first of them where they are and what is drawn. */
function damage_list(damage) {
  if (!damage?.page_count) {
    return [];
  }
  const corner = (point) => point.map((x) => Number(x.toPrecision(5))).join(", ");
  const place = ({ bounds }) => (bounds ? `(${corner(bounds.lo)}) to (${corner(bounds.hi)})` : "in the voxels");
  const items = damage.pages.map((page) =>
    element("li", {}, `Page ${page.page}, drawn ${page.drawn}: ${place(page)}`));
  const others = damage.page_count - damage.pages.length;
  const more = others > 0 ? [element("li", { class: "hint" }, `and ${others} more: trex verify lists them all`)] : [];
  return [
    element("h3", {}, "Damaged pages of the file"),
    element("p", { class: "hint" }, `${damage.page_count} cannot be read. Boxes are in units of the model.`),
    element("ul", { class: "list damage", "aria-label": "Damaged pages" }, ...items, ...more),
  ];
}
