// The help: every key and every way of the hand, from the table in keys.js.

import { HANDS, KEYS } from "./keys.js";
import { button, element } from "./widgets.js";

const NAMES = {
  ArrowLeft: "←",
  ArrowRight: "→",
  ArrowUp: "↑",
  ArrowDown: "↓",
  Escape: "Esc",
};

export class Help {
  constructor(dialog) {
    this.dialog = dialog;
    // A click beside the text is one on the dialog itself.
    dialog.addEventListener("click", (event) => event.target === dialog && dialog.close());
  }

  get is_open() {
    return this.dialog.open;
  }

  toggle() {
    if (this.dialog.open) {
      this.dialog.close();
      return;
    }
    const close = button("×", () => this.dialog.close(), { class: "quiet close", "aria-label": "Close the help" });
    const columns = [table("By hand", HANDS.map(([hand, text]) => [[hand], text])),
      ...KEYS.map(([heading, rows]) => table(heading, rows.map(([keys, text]) => [keys.map(name_of), text])))];
    const title = element("h2", {}, "Keys and hands");
    this.dialog.replaceChildren(close, title, element("div", { class: "columns" }, ...columns));
    this.dialog.showModal();
  }
}

/** A key as its cap has it. */
export function name_of(key) {
  const parts = key.length > 1 ? key.split(/\+(?=.)/) : [key];
  const named = parts.map((part) => NAMES[part] ?? (part.length === 1 ? part.toUpperCase() : part));
  return named.join(" + ");
}

function table(heading, rows) {
  const cells = rows.map(([keys, text]) => {
    const caps = keys.flatMap((key, at) => [at > 0 ? " " : "", element("kbd", {}, key)]);
    return element("tr", {}, element("th", { scope: "row" }, ...caps), element("td", {}, text));
  });
  return element("section", {}, element("h3", {}, heading), element("table", {}, ...cells));
}
