// The parameters of a node, with editors.
import { el, number } from "./dom.js";
import { timeline } from "./timeline.js";

const FOLLOWS = /^\s*(Axis|Track|Param)\s*\(/;

// A documentation text without the line breaks inside its paragraphs.
export const flowing = (doc) => doc.replace(/(\S)[ \t]*\n[ \t]*(?=[^\s*-])/g, "$1 ");

// Splits the entries of a list or group, with their text; null for anything else.
export function entries(text) {
  const inner = /^\s*[([]([\s\S]*)[)\]]\s*$/.exec(text);
  if (!inner) return null;
  const parts = inner[1].split(",").map((part) => part.trim());
  if (parts.at(-1) === "") parts.pop();
  return parts.every((part) => /^[-+]?[\d.][\d._eE+-]*$/.test(part)) ? parts : null;
}

// A number in RON: whole numbers as they are, others with a point.
function ron(value, whole) {
  if (whole) return String(Math.round(value));
  const text = String(Number(value.toPrecision(6)));
  return /[.e]/.test(text) ? text : `${text}.0`;
}

// A number in RON with at most `digits` digits behind the point.
export function decimal(value, digits) {
  const text = String(Number(value.toFixed(digits)) || 0);
  return /[.e]/.test(text) ? text : `${text}.0`;
}

// A scale in metres per unit in RON, with five digits or more.
export const scaleText = (value) => decimal(value, Math.min(12, Math.max(1, 5 - Math.floor(Math.log10(value)))));

// Maps a slider from 0 to 1000 to the values of a number, by its range.
export function scale(range, value, whole, unit) {
  const [low, high] = range ?? [-Infinity, Infinity];
  if (high - low <= 1000) {
    const step = whole ? 1 : 10 ** Math.round(Math.log10((high - low) / 500));
    const snapped = (v) => Math.min(high, Math.max(low, Math.round(v / step) * step));
    return { from: (s) => snapped(low + (s / 1000) * (high - low)), to: (v) => ((v - low) / (high - low)) * 1000 };
  }
  if (/deg/.test(unit)) {
    const base = 180 * Math.max(1, Math.ceil(Math.abs(value) / 180));
    return { from: (s) => Math.round((s / 1000) * 2 * base - base), to: (v) => ((v + base) / (2 * base)) * 1000 };
  }
  if (low >= 0 && value > 0 && Number.isFinite(value)) {
    // A factor of 16 in both directions.
    const snapped = (v) => Math.min(high, Math.max(low, whole ? Math.round(v) : Number(v.toPrecision(2))));
    return { from: (s) => snapped(value * 16 ** ((s - 500) / 500)), to: (v) => 500 + 500 * (Math.log(Math.max(v, 1e-12) / value) / Math.log(16)) };
  }
  const reach = Math.max(1, Math.abs(value));
  const step = whole ? 1 : 10 ** Math.round(Math.log10(reach / 250));
  const snapped = (v) => Math.min(high, Math.max(low, Math.round(v / step) * step));
  return { from: (s) => snapped(value + ((s - 500) / 500) * reach), to: (v) => 500 + ((v - value) / reach) * 500 };
}

// Listeners of a control that show what its edit would run while the user is at it, before anything is changed.
const foreseen = (edit, value, at = []) => ({
  onfocus: () => edit.plan(value(), at), onpointerenter: () => edit.plan(value(), at), onblur: () => edit.unplan(), onpointerleave: () => edit.unplan(),
});

// One field. `edit` has `set(value, at)`, `attempt(value, at)`, `revert()`, `plan(value, at)`, `unplan()`, and
// `go(axis, place)`.
// `instances` has the name of the node and those of all its instances along axes.
export function field(param, value, edit, fixed, instances) {
  const text = value.text ?? value.value ?? "";
  const follows = FOLLOWS.exec(text) ?? /\b(Axis|Track|Param)\s*\(/.exec(text);
  const keys = fixed || param.is_path ? null : timeline(param, text, instances, edit, (part, at, own) => numberRow(param, part, at, false, own));
  const why = fixed ?? (keys ? null : param.is_path ? "Paths are edited in the text." : follows ? `The value comes from ${follows[1]}(..); edit it in the text.` : null);
  const head = el("div", { class: "head" }, el("b", {}, param.name),
    param.unit && el("span", { class: "unit" }, param.unit),
    param.range && Math.max(...param.range.map(Math.abs)) <= 1e4 && el("span", { class: "unit" }, `${number(param.range[0])} to ${number(param.range[1])}`),
    value.text === null && el("span", { class: "unit" }, "default"));
  if (value.text !== null && param.default !== null && !why && !keys) {
    head.append(el("span", { class: "space" }), el("button", {
      type: "button", title: `Remove it from the text; the default is ${param.default}`, onclick: () => edit.set(null, []), ...foreseen(edit, () => null),
    }, "Default"));
  }
  const wrong = el("div", { class: "wrong", role: "alert" });
  const rows = why ? [el("div", { class: "row" }, el("code", {}, text)), el("div", { class: "dim" }, why)] : keys ?? editors(param, text, { ...edit, wrong });
  return el("div", { class: `field${value.text === null ? "" : " set"}`, "data-field": param.name },
    head, rows, wrong, el("details", { class: "doc" }, el("summary", {}, flowing(param.doc).split(/(?<=\.)\s/)[0]), `${flowing(param.doc)}\nType: ${param.type}`));
}

function editors(param, text, edit) {
  const type = param.type.replace(/ \(optional\)$/, "");
  const isNumber = (part) => /^[-+]?[\d.][\d._eE+-]*$/.test(part);
  if (type === "true | false") {
    const box = el("input", { type: "checkbox", checked: text === "true", "aria-label": param.name, onchange: () => edit.set(String(box.checked), []), ...foreseen(edit, () => String(!box.checked)) });
    return [el("label", { class: "row" }, box, text === "true" ? "on" : "off")];
  }
  if (["number", "whole number", "integer"].includes(type) && isNumber(text)) {
    return [numberRow(param, text, [], type !== "number", edit)];
  }
  const parts = entries(text);
  if (parts && parts.length <= 4 && /number/.test(type)) {
    return parts.map((part, index) => numberRow(param, part, [index], false, edit));
  }
  const rows = [];
  const word = /^\w+/.exec(text)?.[0] ?? "";
  if (param.choices.length > 1) {
    const known = param.choices.some((choice) => choice.name === word);
    const select = el("select", { "aria-label": param.name, onchange: () => edit.set(select.value, []), ...foreseen(edit, () => param.choices.find((choice) => choice.name !== word).name) },
      !known && el("option", { value: text, selected: true }, text),
      param.choices.map((choice) => el("option", { value: choice.name, selected: choice.name === word, title: choice.doc }, choice.name)));
    rows.push(el("div", { class: "row" }, select), el("div", { class: "dim" }, param.choices.find((choice) => choice.name === word)?.doc ?? ""));
    if (text === word) return rows;
  }
  return [...rows, textRow(param, text, [], edit)];
}

// A value that is written is no longer being typed.
function written(input, set) {
  input.defaultValue = input.value;
  set();
}

function textRow(param, text, at, edit) {
  const input = el("input", {
    type: "text", value: text, "aria-label": param.name, spellcheck: "false",
    oninput: () => edit.plan(input.value, at), onchange: () => written(input, () => edit.set(input.value, at)),
    onkeydown: (event) => { if (event.key === "Escape") { input.value = text; edit.revert(); event.stopPropagation(); } },
  });
  return el("div", { class: "row" }, input);
}

function numberRow(param, text, at, whole, edit) {
  const value = Number(text.replaceAll("_", ""));
  const { from, to } = scale(param.range, value, whole, param.unit);
  // Every other value runs the same nodes, unless it was computed before. So this is one that the slider does not give.
  const other = from(Math.abs(to(value) - 500) < 250 ? to(value) + 100 : 500);
  const unseen = ron(whole ? other : value + (other - value) * 0.918273, whole);
  const name = at.length ? `${param.name} ${at[0] + 1}` : param.name;
  const slider = el("input", {
    type: "range", min: 0, max: 1000, step: "any", value: to(value), "aria-label": name, "aria-valuetext": text,
    oninput: () => {
      input.value = ron(from(Number(slider.value)), whole);
      slider.setAttribute("aria-valuetext", input.value);
      edit.attempt(input.value, at);
    },
    onchange: () => edit.set(input.value, at),
    ...foreseen(edit, () => unseen, at),
    onkeydown: (event) => {
      if (event.key !== "Escape") return;
      [input.value, slider.value] = [text, to(value)];
      edit.revert();
      event.stopPropagation();
    },
  });
  const input = el("input", {
    type: "text", class: "number", value: text, "aria-label": `${name} as text`, inputmode: "decimal", spellcheck: "false",
    oninput: () => edit.plan(input.value, at), onchange: () => written(input, () => edit.set(input.value, at)),
    onkeydown: (event) => { if (event.key === "Escape") { input.value = text; edit.revert(); event.stopPropagation(); } },
  });
  return el("div", { class: "row" }, slider, input);
}
