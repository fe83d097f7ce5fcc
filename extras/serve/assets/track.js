// The text of values that are interpolated between keys along an axis: `Track("frame", [(0, 0.0), (11, 330.0)])`.

const HEAD = /^\s*Track\s*\(\s*"([^"\\]*)"\s*,\s*\[/;
const NUMBER = "[-+]?[\\d._]+(?:[eE][-+]?\\d+)?";
const KEY = new RegExp(`^\\(\\s*(${NUMBER})\\s*,\\s*(${NUMBER}|\\(\\s*${NUMBER}(?:\\s*,\\s*${NUMBER})*\\s*,?\\s*\\))\\s*,?\\s*\\)`);
const numbers = (text) => text.replace(/[()\s_]/g, "").split(",").filter(Boolean).map(Number);

// The axis and the keys, each with its place, its values, and its position in the text; null for any other text.
export function tracked(text) {
  const head = HEAD.exec(text ?? "");
  if (!head) return null;
  const keys = [];
  let at = head[0].length;
  for (;;) {
    at += /^[\s,]*/.exec(text.slice(at))[0].length;
    const key = KEY.exec(text.slice(at));
    if (!key) break;
    const from = at + key[0].indexOf(key[2], key[0].indexOf(",") + 1);
    keys.push({ at: Number(key[1].replaceAll("_", "")), name: key[1], values: numbers(key[2]), start: at, end: at + key[0].length, value: [from, from + key[2].length] });
    at += key[0].length;
  }
  return keys.length && /^\s*\]\s*,?\s*\)\s*$/.test(text.slice(at)) ? { axis: head[1], keys, text } : null;
}

// The values at a place: linear between keys, constant before the first and after the last.
export function valuesAt({ keys }, place) {
  const after = keys.findIndex((key) => key.at > place);
  if (after < 0) return keys.at(-1).values;
  if (after === 0) return keys[0].values;
  const [from, to] = [keys[after - 1], keys[after]];
  const share = (place - from.at) / (to.at - from.at);
  return from.values.map((value, i) => value + (to.values[i] - value) * share);
}

export const keyAt = ({ keys }, place) => keys.findIndex((key) => Math.abs(key.at - place) < 1e-9);

// The text with a key at a place, which is a text such as `3`. `value` is the value of the key in RON.
export function keyed(track, place, value) {
  const { keys, text } = track;
  const known = keys[keyAt(track, Number(place))];
  if (known) return text.slice(0, known.value[0]) + value + text.slice(known.value[1]);
  const after = keys.findIndex((key) => key.at > Number(place));
  if (after < 0) return `${text.slice(0, keys.at(-1).end)}, (${place}, ${value})${text.slice(keys.at(-1).end)}`;
  return `${text.slice(0, keys[after].start)}(${place}, ${value}), ${text.slice(keys[after].start)}`;
}

// The text without the key of an index; null for the only key.
export function unkeyed({ keys, text }, index) {
  if (keys.length < 2) return null;
  if (index + 1 < keys.length) return text.slice(0, keys[index].start) + text.slice(keys[index + 1].start);
  return text.slice(0, keys[index - 1].end) + text.slice(keys[index].end);
}

// The text with the key of an index at another place. A key that is there already is replaced.
export function moved(track, index, place) {
  const key = track.keys[index];
  const value = track.text.slice(...key.value);
  const there = tracked(keyed(track, place, value));
  return unkeyed(there, keyAt(there, key.at));
}

// The place of an instance along an axis, as it is written in its name: `pose/frame=3` has the place `3` along `frame`.
export function placeOf(id, axis) {
  const part = id.split("/").slice(1).find((one) => one.startsWith(`${axis}=`));
  return part ? part.slice(axis.length + 1) : null;
}
