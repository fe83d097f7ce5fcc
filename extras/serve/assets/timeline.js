// The editor of a value with keys along an axis: the keys on a timeline, and the value at the place that is shown.
import { el, number, svg } from "./dom.js";
import { keyAt, keyed, moved, placeOf, tracked, unkeyed, valuesAt } from "./track.js";

const [WIDTH, HEIGHT, EDGE] = [320, 64, 12];
const COLOURS = ["#e0564f", "#57b05a", "#4f8fe8", "#e6b93c"];

// `id` is the name of the instance that is shown, and `places` are the places of all instances. `edit` has `set` and `go`,
// and `row(text, index, edit)` makes the editor of one number. Null if the text has no keys that can be edited.
export function timeline(param, text, { id, ids }, edit, row) {
  const track = tracked(text);
  const place = track && placeOf(id, track.axis);
  if (!place) return null;
  const places = [...new Set(ids.map((one) => placeOf(one, track.axis)).filter((one) => one !== null))].sort((a, b) => Number(a) - Number(b));
  const [low, high] = [Math.min(Number(places[0]), track.keys[0].at), Math.max(Number(places.at(-1)), track.keys.at(-1).at)];
  const x = (at) => EDGE + ((at - low) / (high - low || 1)) * (WIDTH - 2 * EDGE);
  const all = track.keys.flatMap((key) => key.values);
  const [least, most] = [Math.min(...all), Math.max(...all)];
  const y = (value) => HEIGHT - 12 - ((value - least) / (most - least || 1)) * (HEIGHT - 26);
  const nearest = (at) => places.reduce((best, one) => (Math.abs(Number(one) - at) < Math.abs(Number(best) - at) ? one : best), places[0]);

  const curves = track.keys[0].values.map((_, k) => svg("polyline", {
    class: "curve", stroke: COLOURS[k],
    points: [[low, track.keys[0].values[k]], ...track.keys.map((key) => [key.at, key.values[k]]), [high, track.keys.at(-1).values[k]]].map(([at, v]) => `${x(at)},${y(v)}`).join(" "),
  }));
  const key = (one, index) => {
    const points = (at) => `${x(at)},2 ${x(at) + 5},8 ${x(at)},14 ${x(at) - 5},8`;
    const mark = svg("polygon", {
      class: `key${keyAt(track, Number(place)) === index ? " here" : ""}`, points: points(one.at), tabindex: 0, role: "slider", "aria-label": `Key of ${param.name} at ${track.axis} = ${one.name}`,
      "aria-valuenow": one.at, "aria-valuemin": low, "aria-valuemax": high,
      onkeydown: (event) => {
        const at = places.indexOf(nearest(one.at)) + ({ ArrowLeft: -1, ArrowRight: 1 }[event.key] ?? 0);
        if (["ArrowLeft", "ArrowRight"].includes(event.key) && places[at]) edit.set(moved(track, index, places[at]), []);
        else if (event.key === "Delete" && unkeyed(track, index)) edit.set(unkeyed(track, index), []);
        else if (event.key === "Enter") edit.go(track.axis, nearest(one.at));
        else return;
        event.preventDefault();
        event.stopPropagation();
      },
      onpointerdown: (event) => {
        event.preventDefault();
        event.stopPropagation();
        mark.setPointerCapture(event.pointerId);
        mark.focus();
        let to = null;
        const move = (next) => {
          to = nearest(under(next));
          mark.setAttribute("points", points(Number(to)));
        };
        mark.addEventListener("pointermove", move);
        mark.addEventListener("pointerup", () => {
          mark.removeEventListener("pointermove", move);
          if (to !== null && Number(to) !== one.at) edit.set(moved(track, index, to), []);
          else edit.go(track.axis, nearest(one.at));
        }, { once: true });
      },
    }, svg("title", {}, `${track.axis} = ${one.name}: ${one.values.map(number).join(", ")}\nDrag: move; Delete: remove`));
    return mark;
  };
  const drawing = svg("svg", { class: "timeline", viewBox: `0 0 ${WIDTH} ${HEIGHT}`, onpointerdown: (event) => edit.go(track.axis, nearest(under(event))) },
    svg("rect", { class: "box", x: 0, y: 0, width: WIDTH, height: HEIGHT, rx: 4 }),
    places.length <= 200 ? places.map((one) => svg("line", { class: "grid", x1: x(Number(one)), x2: x(Number(one)), y1: HEIGHT - 6, y2: HEIGHT })) : null,
    curves, svg("line", { class: "now", x1: x(Number(place)), x2: x(Number(place)), y1: 0, y2: HEIGHT }), track.keys.map(key));
  function under(event) {
    const box = drawing.getBoundingClientRect();
    return low + ((((event.clientX - box.left) / box.width) * WIDTH - EDGE) / (WIDTH - 2 * EDGE)) * (high - low);
  }

  // A number that is edited here becomes a key at the place that is shown.
  const now = valuesAt(track, Number(place));
  const written = (values) => (values.length > 1 ? `(${values.join(", ")})` : values[0]);
  const short = (v) => { const t = String(Number(v.toPrecision(6))); return /[.e]/.test(t) ? t : `${t}.0`; };
  const whole = (value, at) => keyed(track, place, written(now.map((v, k) => (k === (at[0] ?? 0) ? value : short(v)))));
  const own = { revert: edit.revert, set: (value, at) => edit.set(whole(value, at), []), attempt: (value, at) => edit.attempt(whole(value, at), []), plan: (value, at) => edit.plan(whole(value, at), []), unplan: edit.unplan };
  const index = keyAt(track, Number(place));
  return [drawing,
    el("div", { class: "row" }, el("span", { class: "dim" }, `${track.axis} = ${place}${index < 0 ? ", between keys" : ", a key"}`), el("span", { class: "space" }),
      index < 0 ? el("button", { type: "button", title: "Writes the value that is interpolated here as a key", onclick: () => edit.set(keyed(track, place, written(now.map(short))), []) }, "Key here")
        : el("button", { type: "button", disabled: track.keys.length < 2, onclick: () => edit.set(unkeyed(track, index), []) }, "Remove key")),
    now.map((v, k) => row(short(v), now.length > 1 ? [k] : [], own))];
}
