// The line at the bottom of the page, and the model's name at its top.
//
// Invariants: 1. a picture that lacks damaged pages of the file is never called done; 2. what the server does not say
// is not shown.

import { bytes, short } from "./widgets.js";

const byId = (id) => document.getElementById(id);
const STAGES = {
  preview: "Preview",
  part: "Sharpening",
  block: "Sharpening",
  complete: "Converging",
  done: "Done",
  screenshot: "Rendering a picture to save",
  damaged: "Damaged: not all of the model is shown",
};
/** Stages after which no frame comes by itself. */
const ENDS = ["done", "damaged"];

/** What is under way. */
function show_progress(stats) {
  const has_ended = ENDS.includes(stats.progress);
  const share = has_ended ? 1 : Math.min(1, (stats.samples ?? 0) / Math.max(1, stats.spp ?? 1));
  byId("bar").style.transform = `scaleX(${share})`;
  const counts_samples = !has_ended && stats.progress !== "screenshot" && Number.isFinite(stats.samples);
  byId("progress").textContent = !counts_samples
    ? STAGES[stats.progress] ?? ""
    : `${STAGES[stats.progress] ?? ""} ${stats.samples} of ${stats.spp}`;
  const { used_bytes, limit_bytes } = stats.memory ?? {};
  byId("memory").textContent = Number.isFinite(used_bytes) ? `${bytes(used_bytes)} of ${bytes(limit_bytes)}` : "";
  byId("rate").textContent = stats.fps >= 1 && !has_ended ? `${stats.fps.toFixed(0)}/s` : "";
}

/** What is done before there is a session, or between two. */
function show_waiting({ text, share }) {
  document.body.dataset.link = "waiting";
  byId("placeholder").hidden = false;
  byId("placeholder").textContent = text;
  byId("bar").style.transform = `scaleX(${share ?? 0})`;
  for (const id of ["progress", "memory", "rate", "role"]) {
    byId(id).textContent = "";
  }
}

/** Keeps both lines: what is under way, who drives, whether the server is there; the model's name. */
export function keep_status(app) {
  const LINKS = { connecting: "connecting", reconnecting: "lost, trying again", lost: "lost", refused: "refused" };
  const show = () => {
    const is_open = app.connection.is_open && app.link === "open";
    const role = app.state.role === "drive" ? "driving" : "watching";
    const others = (app.state.clients ?? 1) - 1;
    const name = is_open ? role : LINKS[app.link] ?? "connecting";
    document.body.dataset.link = is_open ? role : app.link;
    // Who is alone drives, and has nobody to tell from.
    const together = others > 0 ? `${name}, ${others} more here` : "";
    byId("role").textContent = is_open ? together : name;
    byId("drive").hidden = !is_open || app.state.role === "drive";
  };
  byId("drive").addEventListener("click", () => app.connection.send({ type: "drive" }));
  const show_size = () => {
    const { smaller, size } = app.state;
    const limit = smaller?.limit_bytes ? `: ${bytes(smaller.limit_bytes)} would do` : "";
    byId("smaller").textContent = smaller ? `${size.join("×")} of ${smaller.asked.join("×")}${limit}` : "";
    byId("smaller").title = smaller ? "The memory limit has no room for a picture as large as the page." : "";
  };
  const show_damage = () => {
    const count = app.state.damage?.page_count ?? 0;
    byId("damage").hidden = count === 0;
    const text = count === 1 ? "1 page of the file is damaged" : `${count} pages of the file are damaged`;
    byId("damage").textContent = text;
    byId("damage").setAttribute("aria-label", `${text}: show which`);
  };
  byId("damage").addEventListener("click", () => app.panels.open("statistics"));
  app.listen("damage", show_damage);
  app.listen("waiting", show_waiting);
  app.listen("stats", show_progress);
  app.listen("smaller", show_size);
  app.listen("size", show_size);
  app.listen("link", show);
  app.listen("role", show);
  app.listen("clients", show);
  app.listen("welcome", (state) => {
    app.link = "open";
    show();
    document.title = `${state.name} · trex`;
    byId("name").textContent = state.name;
    const count = state.model?.triangle_count;
    byId("count").textContent = Number.isFinite(count) ? `${short(count)} triangles` : "";
  });
}
