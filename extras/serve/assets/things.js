// The objects of the place view: where they stand, and the edits that move them.
import { $, number } from "./dom.js";
import { decimal, entries } from "./fields.js";
import { keyed, placeOf, tracked } from "./track.js";
import { Ground } from "./ground.js";
import { add, column, dot, length, moved, mul, point, sub } from "./space.js";

export const wrapped = (degrees) => ((((degrees + 180) % 360) + 360) % 360) - 180;
const degrees = (radians) => (radians * 180) / Math.PI;

export function Things(stage) {
  const { page, note, redraw } = stage;

  // The lowest and the highest corner of an object in the world, along the axes of the world.
  function corners(one, m) {
    const known = stage.bounds(one);
    const origin = column(m, 3);
    if (!known) return [origin, origin];
    const all = Array.from({ length: 8 }, (_, i) => point(m, [0, 1, 2].map((k) => ((i >> k) & 1 ? known.high[k] : known.low[k]))));
    return [Math.min, Math.max].map((pick) => [0, 1, 2].map((k) => pick(...all.map((p) => p[k]))));
  }

  const ground = Ground(stage, corners);

  // The middle of the lowest side.
  function foot(one, m) {
    const { up } = stage.scene;
    const [low, high] = corners(one, m);
    const centre = mul(add(low, high), 0.5);
    const lowest = Math.min(dot(low, up), dot(high, up));
    return add(centre, mul(up, lowest - dot(centre, up)));
  }

  // The values of a pose that was written, until the page has fetched the new graph.
  let written = null;

  // The values of the pose as the text or a trial has them.
  function pose(one) {
    const node = page.graph().nodes?.find((node) => node.id === one.pose_id);
    if (!node) return null;
    const value = (name) => node.values[name]?.value ?? null;
    const vector = entries(value("translation") ?? "")?.map(Number);
    const values = { node, vector, yaw: Number(value("yaw_deg")), scale: Number(value("scale")), matrix: value("matrix") };
    return written?.id === one.pose_id && written.graph === page.graph() ? { ...values, ...written.values } : values;
  }

  // The reason why an object cannot be moved here; null if it can.
  function fixed(one) {
    if (!one) return "There is no object.";
    if (page.graph().confined) return "This graph belongs to an unpacked bundle, whose files are never written.";
    const known = one.pose && pose(one);
    if (!known) return `The pose of \`${one.node}\` does not come from a \`Pose\`; edit it in the text.`;
    if (known.node.span === null) return `Another file defines \`${one.pose}\`; edit it there.`;
    if (known.matrix && known.matrix !== "None") return `\`${one.pose}\` is given by \`matrix\`; edit that in the text.`;
    return known.vector?.length === 3 ? null : `\`${one.pose}.translation\` is not three numbers.`;
  }

  // The edit of a pose that a change of the object makes.
  function editOf(start, { radians = 0, k = 1, way = [0, 0, 0] }) {
    const { node, vector, yaw, scale } = start.pose;
    const parts = [];
    // A value with keys along an axis gets a key at the place that is shown.
    const along = (field, value) => {
      const track = tracked(node.values[field]?.text);
      const place = track && placeOf(node.id, track.axis);
      return place ? keyed(track, place, value) : value;
    };
    if (length(way) > 0) {
      const next = add(vector, way).map((v) => decimal(v, stage.decimals()));
      const text = node.values.translation?.text;
      if (tracked(text)) parts.push({ field: "translation", at: [], value: along("translation", `(${next.join(", ")})`) });
      else if (!text || entries(text)) parts.push({ field: "translation", at: [], value: `(${next.join(", ")})` });
      else next.forEach((value, i) => { if (way[i]) parts.push({ field: "translation", at: [i], value }); });
    }
    if (radians) parts.push({ field: "yaw_deg", at: [], value: along("yaw_deg", decimal(wrapped(yaw + degrees(radians)), 1)) });
    if (k !== 1) parts.push({ field: "scale", at: [], value: along("scale", decimal(scale * k, Math.max(0, 3 - Math.floor(Math.log10(Math.abs(scale * k)))))) });
    if (!parts.length) return null;
    const [first, ...also] = parts;
    return { node: node.in_file, ...first, also };
  }

  // The start of a change of an object.
  function grab(one) {
    const m = stage.matrix(one);
    return { one, matrix: m, centre: column(m, 3), foot: foot(one, m), pose: pose(one), change: {} };
  }

  // Moves the object on the screen, and tries the value.
  function preview(start, change) {
    start.change = change;
    const matrix = moved(start.matrix, start.centre, { axis: stage.scene.up, ...change });
    stage.override = { node: start.one.node, matrix, before: start.one.matrix, done: false };
    const edit = editOf(start, change);
    if (edit) page.attempt(edit);
    position();
    redraw();
  }

  async function commit(start) {
    const edit = editOf(start, start.change);
    if (!edit) { stage.override = null; page.revert(); redraw(); return; }
    const { radians = 0, k = 1, way = [0, 0, 0] } = start.change;
    const { vector, yaw, scale } = start.pose;
    written = { id: start.one.pose_id, graph: page.graph(), values: { vector: add(vector, way), yaw: wrapped(yaw + degrees(radians)), scale: scale * k } };
    const good = await page.set(edit);
    if (good === null) { [stage.override, written] = [null, null]; redraw(); return; }
    if (stage.override) stage.override.done = true;
    // Without a new result, for instance if its node fails, the object goes back to the last one.
    setTimeout(() => { if (stage.override?.done && !stage.drag) { stage.override = null; stage.load(); } }, 4000);
    stage.load();
  }

  function cancel() {
    [stage.override, stage.drag] = [null, null];
    page.revert();
    position();
    redraw();
    note("");
  }

  // Puts the foot of the object on the ground that a ray hits.
  const onto = (start, ray, then) => ground.ask(ray, (found) => {
    if (stage.drag && stage.drag.start !== start) return;
    if (!ground.stands(found)) return;
    stage.spot = found.position;
    preview(start, { ...start.change, way: sub(found.position, start.foot) });
    then?.();
  });

  function drop() {
    const one = stage.object();
    const why = fixed(one);
    if (why) return note(why);
    const start = grab(one);
    return ground.below(start, [0, 0, 0], (found) => {
      if (!ground.stands(found)) return;
      preview(start, { way: sub(found.position, start.foot) });
      commit(start);
    });
  }

  // Writes the end of a drag, after the last answer about the ground.
  function settle(start) {
    if (ground.waits()) setTimeout(() => settle(start), 10);
    else commit(start);
  }

  // Steps of an object by keys are written when no key has come for a while.
  let stepping = null;
  function step(change) {
    const why = fixed(stage.object());
    if (why) return note(why);
    clearTimeout(stepping?.timer);
    stepping ??= { start: grab(stage.object()) };
    const { start } = stepping;
    const { radians = 0, k = 1, way = [0, 0, 0] } = start.change;
    preview(start, { radians: radians + (change.radians ?? 0), k: k * (change.k ?? 1), way: add(way, change.way ?? [0, 0, 0]) });
    stepping.timer = setTimeout(() => { const ended = stepping; stepping = null; commit(ended.start); }, 450);
    return null;
  }

  // Drops the steps that are not written yet; false if there are none.
  function unstep() {
    if (!stepping) return false;
    clearTimeout(stepping.timer);
    stepping = null;
    cancel();
    return true;
  }

  // Shows what a move of the selected object would run, before it is made. Steps by keys do not give this move, so it was
  // not computed before.
  function foresee() {
    const one = stage.object();
    if (one && !fixed(one)) page.plan(editOf(grab(one), { way: mul(stage.scene.right, 0.0137 * stage.metre()) }));
  }

  // The line that says where the selected object stands.
  function position() {
    const one = stage.object();
    if (!one) { $("place-position").textContent = ""; return; }
    const known = pose(one);
    const short = (p) => p.map((v) => number(Number(v.toFixed(stage.decimals())))).join(", ");
    const at = short(column(stage.matrix(one), 3));
    const yaw = known ? ` · yaw ${number(Number(wrapped(known.yaw).toFixed(1)))}°` : "";
    $("place-position").textContent = `${one.node} at (${at})${yaw}${stage.spot ? ` · ground at (${short(stage.spot)})` : ""}`;
  }

  return { ground, corners, foot, fixed, grab, preview, commit, cancel, onto, drop, settle, step, unstep, position, foresee };
}
