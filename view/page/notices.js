// Notices: what went wrong, or is worth knowing, in four parts: what, where, numbers, next step.
//
// Invariants: 1. errors stay until they are closed, at most NOTICES_MAX of all; 2. the list is a live region, so a
// screen reader says what is added; 3. a notice that comes again counts up and is not added again.

import { button, element } from "./widgets.js";

const NOTICES_MAX = 4;
/** Time that what is no error stays, ms. */
const INFO_MS = 7000;

export class Notices {
  constructor(list) {
    this.list = list;
  }

  /** `notice`: {level: "error" | "info", code?, text, place?, numbers?, next?}. */
  show(notice) {
    const parts = ["place", "numbers", "next"].filter((part) => notice[part]);
    const key = JSON.stringify([notice.level, notice.code, notice.text, notice.place]);
    const before = [...this.list.children].find((item) => item.dataset.key === key);
    before?.remove();
    const times = Number(before?.dataset.times ?? 0) + 1;
    const title = times > 1 ? `${notice.text} (${times} times)` : notice.text;
    const item = element(
      "li",
      { class: `notice ${notice.level === "error" ? "error" : "info"}` },
      element("strong", {}, title),
      ...parts.map((part) => element("span", { class: part }, String(notice[part]))),
      button("×", () => item.remove(), { class: "close", "aria-label": "Close this notice" }),
    );
    [item.dataset.key, item.dataset.times] = [key, times];
    this.list.append(item);
    while (this.list.children.length > NOTICES_MAX) {
      this.list.firstElementChild.remove();
    }
    if (notice.level !== "error") {
      setTimeout(() => item.remove(), INFO_MS);
    }
  }

  info(text, next = "") {
    this.show({ level: "info", text, next });
  }

  clear() {
    this.list.replaceChildren();
  }
}
