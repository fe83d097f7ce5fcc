// Where the user looks from in the place view: cameras, the view from above, flight, and the camera that is set.
import { $ } from "./dom.js";
import { add, column, distance, dot, length, mul, sub, unit } from "./space.js";
import { decimal } from "./fields.js";

// Directions of the keys of flight: right, up, forward.
export const FLIGHT = { w: [0, 0, 1], s: [0, 0, -1], a: [-1, 0, 0], d: [1, 0, 0], e: [0, 1, 0], q: [0, -1, 0] };

// `moving` is called whenever the view moves by itself.
export function Gaze(stage, things, moving) {
  const { page } = stage;
  const start = () => Math.max(stage.scene.cameras.findIndex((one) => one.kind === "Camera"), stage.scene.cameras.length ? 0 : -1);
  const middle = () => stage.solid.cloud()?.origin ?? [0, 0, 0];

  function reach(eye, forward) {
    const one = stage.object();
    const depth = one ? dot(sub(things.foot(one, stage.matrix(one)), eye), forward) : 0;
    return depth > 0 ? depth : stage.radius;
  }

  // Looks through a camera by its index; below 0, freely.
  function look(index) {
    const { scene, view } = stage;
    const camera = scene.cameras[index] ?? null;
    $("place-cut").value = 1;
    if (camera) view.through(camera, reach(column(camera.matrix, 3), column(camera.matrix, 2)));
    else if (!view.camera && distance(view.eye, [0, 0, 0]) === 0) above();
    else { view.free(); view.camera = null; }
    stage.menus();
    stage.redraw();
  }

  // The whole place from above.
  function above() {
    const { scene, view, radius, heights } = stage;
    view.free();
    view.camera = null;
    view.target = middle();
    view.eye = add(middle(), add(mul(scene.forward, -1.7 * radius), mul(scene.up, 2.1 * radius)));
    // Without a ceiling, and without what is above the eyes of the first camera.
    const eye = scene.cameras[start()];
    const one = stage.object();
    if (eye) {
      const top = Math.max(dot(column(eye.matrix, 3), scene.up), one ? dot(things.corners(one, stage.matrix(one))[1], scene.up) : -Infinity);
      $("place-cut").value = (top + 0.05 * radius - heights[0]) / (heights[1] - heights[0] || 1);
    }
    stage.menus();
    stage.redraw();
  }

  function toObject() {
    const { scene, view } = stage;
    const one = stage.object();
    if (!one) return above();
    view.free();
    const size = Math.max(length(sub(...things.corners(one, stage.matrix(one)))), 1e-9);
    const centre = add(things.foot(one, stage.matrix(one)), mul(scene.up, size * 0.3));
    const back = unit(sub(view.eye, centre));
    view.target = centre;
    view.eye = add(centre, mul(length(back) ? back : mul(scene.forward, -1), 2.2 * size));
    stage.redraw();
    return null;
  }

  // After new data: the first view, and the camera that is looked through.
  function follow() {
    const { scene, view } = stage;
    if (!stage.looked) {
      look(start());
      stage.looked = scene.cameras.length > 0 && Boolean(stage.solid.cloud());
    }
    const find = (camera) => camera && scene.cameras.find((one) => one.id === camera.id && one.name === camera.name);
    const same = find(view.camera);
    if (same && view.exact && String(same.matrix) !== String(view.camera.matrix)) look(scene.cameras.indexOf(same));
    else if (same) view.camera = same;
    const set = find(stage.follow);
    if (set && String(set.matrix) !== String(stage.follow.matrix) && view.camera?.id === set.id) {
      stage.follow = null;
      look(scene.cameras.indexOf(set));
    }
  }

  // ---- the camera of the graph

  // The reason why the camera of the view cannot be set; null if it can.
  function fixed() {
    const { camera } = stage.view;
    if (!camera) return "Look through a camera first.";
    if (camera.kind !== "Camera") return `\`${camera.node}\` is a \`${camera.kind}\`, which is not given by eye and target.`;
    return page.graph().confined ? "This graph belongs to an unpacked bundle, whose files are never written." : null;
  }

  // The edit that sets the camera of the graph to the view.
  function edit() {
    const { view } = stage;
    const text = (p) => `(${p.map((v) => decimal(v, stage.decimals())).join(", ")})`;
    const node = page.graph().nodes.find((one) => one.id === view.camera.id);
    const roll = Number(node?.values.roll_deg?.value ?? 0);
    const also = [{ field: "target", at: [], value: text(view.target) }];
    if (roll) also.push({ field: "roll_deg", at: [], value: "0.0" });
    return { node: view.camera.node, field: "eye", at: [], value: text(view.eye), also };
  }

  async function set() {
    const { view } = stage;
    const why = fixed();
    if (why || view.exact) return stage.note(why ?? "The camera is where the view is.");
    const good = await page.set(edit());
    if (good !== null) { stage.follow = view.camera; stage.load(); }
    return null;
  }

  // The button that sets the camera.
  function button() {
    const { view } = stage;
    const why = fixed();
    $("place-set").hidden = view.camera?.kind !== "Camera";
    $("place-set").disabled = Boolean(why) || view.exact;
    $("place-set").textContent = "Set camera";
    $("place-set").title = why ?? (view.exact ? "Move the view first" : `Writes eye and target of \`${view.camera?.node}\` (Enter)`);
  }

  // What the camera would run is shown before it is set.
  const foresee = () => { if (!fixed() && !stage.view.exact) page.plan(edit()); };
  for (const come of ["pointerenter", "focus"]) $("place-set").addEventListener(come, foresee);
  for (const go of ["pointerleave", "blur"]) $("place-set").addEventListener(go, () => page.plan(null));

  // Turns the view by keys, about the point that is looked at.
  function turn(dx, dy) {
    stage.looked = true;
    stage.view.orbit(dx, dy);
    moving();
    stage.redraw();
  }

  // ---- flight

  // The keys of flight that are down.
  const flying = new Set();
  let at = 0;
  function fly() {
    const now = performance.now();
    const seconds = Math.min(0.1, (now - at) / 1000);
    at = now;
    if (!flying.size) return;
    const sum = [...flying].reduce((way, key) => add(way, FLIGHT[key]), [0, 0, 0]);
    stage.view.fly(...mul(sum, 0.6 * stage.radius * seconds));
    moving();
    stage.redraw();
    requestAnimationFrame(fly);
  }

  function press(name) {
    if (!flying.size) { at = performance.now(); requestAnimationFrame(fly); }
    flying.add(name);
  }
  document.addEventListener("keyup", (event) => flying.delete(event.key.toLowerCase()));
  window.addEventListener("blur", () => flying.clear());

  return { look, above, toObject, follow, set, turn, button, press, flies: () => flying.size > 0 };
}
