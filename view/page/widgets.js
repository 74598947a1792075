// Small parts that panels are made of: elements, labelled fields, colours with a strength.
//
// Invariants: 1. text comes in by textContent, never as markup; 2. every field has a label of its own.

let fields = 0;

/** An element `name` with `attributes` ("class", "type", ...; functions become listeners) and children. */
export function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (typeof value === "function") {
      made.addEventListener(key, value);
    } else if (value === true) {
      made.setAttribute(key, "");
    } else if (value !== false && value !== null && value !== undefined) {
      made.setAttribute(key, String(value));
    }
  }
  made.append(...children.filter((child) => child !== null && child !== undefined));
  return made;
}

export const button = (text, pressed, attributes = {}) =>
  element("button", { type: "button", click: pressed, ...attributes }, text);

/** A row: label and field. */
export function row(label, field, hint = null) {
  fields += 1;
  field.id = field.id || `field-${fields}`;
  const text = element("label", { for: field.id, title: hint }, label);
  return element("div", { class: "row" }, text, field);
}

/** A row with a number. `range`: {min, max, step}. `changed(value)` is called for numbers in the range alone. */
export function number_row(label, value, range, changed, hint = null) {
  const field = element("input", {
    type: "number",
    value: shown(value),
    min: range.min,
    max: range.max,
    step: range.step ?? "any",
    change: () => {
      if (field.value !== "" && field.checkValidity()) {
        changed(Number(field.value));
      }
    },
  });
  return row(label, field, hint);
}

/** A row to choose one of `choices` = [[value, text], ...]. */
export function choice_row(label, value, choices, changed, hint = null) {
  const options = choices.map(([key, text]) => element("option", { value: key, selected: key === value }, text));
  const field = element("select", { change: () => changed(field.value) }, ...options);
  return row(label, field, hint);
}

export function switch_row(label, value, changed, hint = null) {
  const field = element("input", { type: "checkbox", checked: value, change: () => changed(field.checked) });
  return row(label, field, hint);
}

/** Places of a slider, 0 to `steps`, on a logarithmic scale of `range`; the leftmost is 0 with `range.zero`. */
export function log_scale(range, steps) {
  const span = Math.log(range.max / range.min);
  const nearest = (number) => Math.round((steps * Math.log(number / range.min)) / span);
  return {
    place: (number) => (number <= 0 ? 0 : Math.max(0, Math.min(steps, nearest(number)))),
    number_at: (at) => (at === 0 && range.zero ? 0 : range.min * Math.exp((span * at) / steps)),
  };
}

/**
 * A slider on a logarithmic scale from `range.min` (> 0) to `range.max`, beside a field for the exact number. The
 * leftmost place of a slider with `range.zero` is 0.
 */
export function slider_row(label, value, range, changed, hint = null) {
  const STEPS = 200;
  const { place, number_at } = log_scale(range, STEPS);
  const slider = element("input", { type: "range", min: 0, max: STEPS, value: place(value), "aria-label": label });
  const field = element("input", { type: "number", min: range.zero ? 0 : range.least ?? 0, max: range.most,
    step: "any" });
  field.value = shown(value);
  slider.addEventListener("input", () => {
    const number = Number(number_at(Number(slider.value)).toPrecision(3));
    field.value = shown(number);
    changed(number);
  });
  field.addEventListener("change", () => {
    if (field.value !== "" && field.checkValidity()) {
      slider.value = place(Number(field.value));
      changed(Number(field.value));
    }
  });
  const made = row(label, field, hint);
  made.classList.add("with-slider");
  made.insertBefore(slider, field);
  return made;
}

/** Three numbers of a point or a direction. */
export function vector_row(label, value, changed) {
  const inputs = ["x", "y", "z"].map((axis, at) =>
    element("input", { type: "number", step: "any", value: shown(value[at]), "aria-label": `${label} ${axis}` }));
  // A field shows fewer digits than its number has: what was not changed stays as it is.
  let now = [...value];
  inputs.forEach((input, at) => input.addEventListener("change", () => {
    if (input.value !== "" && input.checkValidity()) {
      now = now.map((number, axis) => (axis === at ? Number(input.value) : number));
      changed(now);
    }
  }));
  const text = element("span", { class: "label" }, label);
  return element("div", { class: "row vector", role: "group", "aria-label": label }, text, ...inputs);
}

const to_encoded = (linear) => (linear <= 0.0031308 ? 12.92 * linear : 1.055 * linear ** (1 / 2.4) - 0.055);
const to_linear = (encoded) => (encoded <= 0.04045 ? encoded / 12.92 : ((encoded + 0.055) / 1.055) ** 2.4);

/** "#rrggbb" of linear `rgb`. */
export function encoded(rgb) {
  const part = (x) => Math.round(255 * Math.min(1, Math.max(0, to_encoded(x))));
  return `#${rgb.map((x) => part(x).toString(16).padStart(2, "0")).join("")}`;
}

/** "#rrggbb" of the hue of linear `rgb`, its greatest part at full. */
export function swatch(rgb) {
  const most = Math.max(...rgb);
  return encoded(rgb.map((x) => (most > 0 ? x / most : 1)));
}

/** Linear parts of "#rrggbb". */
export function linear(text) {
  return [1, 3, 5].map((at) => to_linear(parseInt(text.slice(at, at + 2), 16) / 255));
}

/**
 * Colour and strength of linear `rgb` = colour * strength, the colour's greatest part 1, in one row. `range`: of the
 * strength's slider.
 */
export function colour_row(label, rgb, range, changed) {
  let strength = Math.max(...rgb);
  let hue = strength > 0 ? rgb.map((x) => x / strength) : [1, 1, 1];
  const tell = () => changed(hue.map((x) => x * strength));
  const picker = element("input", { type: "color", value: swatch(hue), "aria-label": `${label}, colour` });
  picker.addEventListener("input", () => {
    const parts = linear(picker.value);
    const most = Math.max(...parts);
    hue = most > 0 ? parts.map((x) => x / most) : [1, 1, 1];
    strength = most > 0 ? strength : 0;
    tell();
  });
  const made = slider_row(label, strength, { zero: true, ...range }, (value) => {
    strength = value;
    tell();
  });
  made.classList.add("with-colour");
  made.insertBefore(picker, made.children[1]);
  return made;
}

/** A number as people write it: a whole one with all its digits, others with six at most. */
export function shown(number) {
  if (Number.isSafeInteger(number)) {
    return String(number);
  }
  return Number.isFinite(number) ? String(Number(number.toPrecision(6))) : "";
}

/** A count with a prefix: 12.3 M. */
export function short(number) {
  const prefixes = ["", " k", " M", " G", " T"];
  let [value, at] = [Math.abs(number), 0];
  while (value >= 999.5 && at < prefixes.length - 1) {
    [value, at] = [value / 1000, at + 1];
  }
  const digits = at === 0 && Number.isInteger(value) ? 0 : value < 9.995 ? 2 : value < 99.95 ? 1 : 0;
  return `${number < 0 ? "-" : ""}${value.toFixed(digits)}${prefixes[at]}`;
}

/** Bytes: 97.7 MiB. */
export function bytes(number) {
  const units = ["B", "KiB", "MiB", "GiB", "TiB"];
  let [value, at] = [number, 0];
  while (value >= 999.5 && at < units.length - 1) {
    [value, at] = [value / 1024, at + 1];
  }
  return `${at === 0 || value >= 999.5 ? value.toFixed(0) : value.toPrecision(3)} ${units[at]}`;
}

/** Keeps what is called within one animation frame to the last call. */
export function once_a_frame(call) {
  let wanted = null;
  return (...given) => {
    if (wanted === null) {
      requestAnimationFrame(() => {
        const last = wanted;
        wanted = null;
        call(...last);
      });
    }
    wanted = given;
  };
}
