// The place view: the captured place in three dimensions, in which objects and cameras are placed by hand.
import { $, framed, number } from "./dom.js";
import { Adder } from "./adder.js";
import { FLIGHT, Gaze } from "./gaze.js";
import { Lines } from "./gizmo.js";
import { Measure } from "./measure.js";
import { Pointer } from "./pointer.js";
import { Solid } from "./solid.js";
import { column, distance, dot, length, mul, sub, unit } from "./space.js";
import { Stage } from "./stage.js";
import { Starter } from "./starter.js";
import { Things } from "./things.js";

// A rig with more cameras than this is that of a capture: its cameras are points.
const FEW_CAMERAS = 12;

// A step by which keys turn the view, in radians.
const TURN = Math.PI / 36;

// `page` gives the graph (`graph()`), the state (`state()`), the picture of the graph (`picture()`), the place along
// the axes (`along()`), edits (`set`, `attempt`, `revert`, `plan`), `choose`, `notify`, `start`, `turn` and `add`.
export function Place(page) {
  const [pane, box] = [$("place"), $("space")];
  const solid = Solid($("solid"));
  if (solid.failure) {
    $("space-note").textContent = solid.failure;
    return { open() {}, reveal() {}, changed() {}, pictured() {}, key: () => false };
  }
  const lines = Lines($("lines"));
  const redraw = framed(draw);
  const stage = Stage({ page, solid, redraw, arrived: () => { starter.draw(); adder.draw(); }, settled: () => { gaze.follow(); starter.greet(); } });
  const things = Things(stage);
  const gaze = Gaze(stage, things, coarse);
  const pointer = Pointer(stage, things, gaze, lines, coarse);
  const starter = Starter(stage, things, pointer);
  const adder = Adder(stage, things, pointer);
  const measure = Measure(stage, things, pointer);

  // ---- keys

  // The horizontal axis of the world that is nearest to a direction.
  function level(direction) {
    const { right, forward } = stage.scene;
    const sides = [right, forward, mul(right, -1), mul(forward, -1)];
    return sides.reduce((best, axis) => (dot(axis, direction) > dot(best, direction) + 1e-9 ? axis : best));
  }

  function key(event) {
    const { scene, view } = stage;
    if (!scene || event.ctrlKey || event.metaKey || event.altKey) return false;
    const name = event.key.toLowerCase();
    if (pointer.aim(event)) return true;
    if (FLIGHT[name]) {
      gaze.press(name);
      return true;
    }
    const reach = (event.shiftKey ? 0.1 : 0.01) * stage.metre();
    const [right, , forward] = view.axes();
    const ahead = level(sub(forward, mul(scene.up, dot(forward, scene.up))));
    const move = (axis, by) => things.step({ way: mul(axis, by) });
    const dolly = (by) => { view.dolly(by); redraw(); };
    const next = (list, at) => (at + 1) % Math.max(1, list.length);
    const action = {
      arrowright: () => move(level(right), reach), arrowleft: () => move(level(right), -reach),
      arrowup: () => move(ahead, reach), arrowdown: () => move(ahead, -reach),
      pageup: () => move(scene.up, reach), pagedown: () => move(scene.up, -reach),
      ",": () => things.step({ radians: Math.PI / 36 }), ".": () => things.step({ radians: -Math.PI / 36 }),
      "<": () => things.step({ k: 1 / 1.05 }), ">": () => things.step({ k: 1.05 }),
      j: () => gaze.turn(-TURN, 0), l: () => gaze.turn(TURN, 0), i: () => gaze.turn(0, -TURN), k: () => gaze.turn(0, TURN),
      g: things.drop, x: pointer.placeByClick, c: () => gaze.look(next(scene.cameras, Number($("place-view").value || -1))),
      m: measure.begin, n: () => pointer.select(next(scene.objects, stage.selected)),
      0: gaze.above, f: gaze.toObject, o: () => onion($("place-onion").value > 0 ? 0 : 1), enter: gaze.set,
      "+": () => dolly(0.8), "-": () => dolly(1.25),
      escape: () => { if (stage.drag?.start) things.cancel(); else if (!things.unstep()) { pointer.wait(null); measure.leave(); } },
    }[name];
    if (!action) return false;
    action();
    return true;
  }

  // ---- drawing

  // While the view moves, frames that would take long are drawn with fewer pixels and splats.
  let cost = 0;
  let resting = null;
  function coarse() {
    clearTimeout(resting);
    resting = setTimeout(() => { resting = null; redraw(); }, 250);
  }
  const detail = () => (cost < 50 ? { scale: 1, stride: 1 } : cost < 250 ? { scale: 0.7, stride: 4 } : { scale: 0.5, stride: 16 });

  function draw() {
    const { scene, view, radius } = stage;
    if (!scene || pane.hidden || !view) return;
    view.size = [box.clientWidth, box.clientHeight];
    if (!view.size[0] || !view.size[1]) return;
    const objects = scene.objects.filter((one) => solid.has(one.shape)).map((one) => [one.shape, stage.matrix(one)]);
    const solids = $("place-objects").checked ? objects : [];
    const ghost = $("place-mesh").checked ? stage.mesh()?.digest : null;
    const near = Math.min(0.2 * stage.metre(), 0.05 * radius);
    const moves = Boolean(stage.drag?.going || gaze.flies() || resting);
    const { scale, stride } = moves ? detail() : { scale: 1, stride: 1 };
    const took = solid.draw(view, { solids, ghost, showSplats: $("place-cloud").checked, scale: radius, near, cut: stage.cut(), ratio: devicePixelRatio * scale, stride, timed: !moves });
    cost = took ?? cost;
    lines.begin(view, devicePixelRatio);
    if (view.camera) lines.mask();
    if ($("place-guides").checked) guides();
    lines.triad();
    if (stage.tool) lines.aim(stage.aim);
    overlay();
    gaze.button();
  }

  // Cameras, probes, and the gizmo of the selected object.
  function guides() {
    const { scene, view, radius, drag } = stage;
    const hot = pointer.hot();
    const sizes = new Map();
    for (const { id } of scene.cameras) sizes.set(id, (sizes.get(id) ?? 0) + 1);
    const through = view.exact && view.camera;
    scene.cameras.forEach((one, index) => {
      // Near ones are small, so that they do not cover the place.
      const away = distance(column(one.matrix, 3), view.eye);
      if (through === one || away <= 0.02 * radius) return;
      const isHot = hot === `camera ${index}`;
      if (sizes.get(one.id) <= FEW_CAMERAS || isHot) lines.camera(one, index, Math.min(0.12 * radius, 0.15 * away), one.kind === "Camera");
      else if (!through) lines.spot(one, index);
    });
    scene.probes.forEach((one) => lines.probe(one, Math.min(0.04 * radius, 0.03 * distance(one.eye, view.eye))));
    lines.mark(stage.spot);
    lines.ruler(stage.ruler, stage.ruler.length === 2 ? `${number(distance(...stage.ruler) * scene.metres_per_unit)} m` : "");
    if (scene.objects.length > 1) scene.objects.forEach((one, index) => { if (index !== stage.selected) lines.tag(one.node, index, things.foot(one, stage.matrix(one))); });
    const one = stage.object();
    if (!one || things.fixed(one)) return;
    const m = stage.matrix(one);
    if (drag?.start && stage.spot) { const [low, high] = things.corners(one, m); lines.contact(things.foot(one, m), stage.spot, 0.35 * distance(low, high)); }
    // The front of a file of glTF is +z.
    const front = sub(column(m, 2), mul(scene.up, dot(column(m, 2), scene.up)));
    lines.gizmo(column(m, 3), unit(length(front) > 1e-12 * length(column(m, 2)) ? front : mul(scene.forward, -1)), drag?.start ? drag.kind : hot);
  }

  // The traced picture, over the view of its camera or in the corner.
  let pictured = "";
  function overlay() {
    const { view } = stage;
    const found = page.picture();
    const [layer, corner] = [$("onion"), $("inset")];
    const opacity = Number($("place-onion").value);
    const href = found ? `/value/${found.digest}/${found.number}.png` : "";
    if (href !== pictured) {
      pictured = href;
      if (href) { layer.src = href; corner.src = `${href}?size=320`; }
    }
    const fits = Boolean(found && view.camera && Math.abs(found.width / found.height - view.camera.width / view.camera.height) < 0.02);
    layer.hidden = !(fits && view.exact && opacity > 0);
    corner.hidden = !href || !layer.hidden || !$("place-corner").checked;
    $("place-onion").disabled = !fits;
    if (layer.hidden) return;
    const [left, top, width, height] = view.rectangle();
    Object.assign(layer.style, { left: `${left}px`, top: `${top}px`, width: `${width}px`, height: `${height}px`, opacity });
  }

  function onion(value) {
    $("place-onion").value = value;
    if (value > 0 && stage.view.camera && !stage.view.exact) gaze.look(stage.scene.cameras.indexOf(stage.view.camera));
    redraw();
  }

  $("place-view").addEventListener("change", () => gaze.look($("place-view").value === "" ? -1 : Number($("place-view").value)));
  $("place-splats").addEventListener("change", () => stage.splats().then(redraw));
  $("place-object").addEventListener("change", () => {
    pointer.select(Number($("place-object").value));
    page.choose(stage.object().pose_id ?? stage.object().node);
  });
  $("place-mesh").addEventListener("change", async () => { if (stage.mesh()) await stage.shape(stage.mesh().digest, `/mesh/${stage.mesh().digest}`); redraw(); });
  $("place-cut").addEventListener("input", redraw);
  for (const id of ["place-cloud", "place-objects", "place-guides", "place-corner"]) $(id).addEventListener("change", redraw);
  $("place-onion").addEventListener("input", () => onion(Number($("place-onion").value)));
  $("place-click").addEventListener("click", pointer.placeByClick);
  $("place-drop").addEventListener("click", things.drop);
  $("place-set").addEventListener("click", gaze.set);
  $("place-all").addEventListener("click", gaze.above);
  // The folders may have other objects when the user comes back to the page.
  window.addEventListener("focus", changed);
  new ResizeObserver(redraw).observe(box);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  $("solid").addEventListener("webglcontextlost", (event) => { event.preventDefault(); stage.note("The graphics driver stopped; open the page again."); });

  // Results come in bursts.
  let soon = null;
  function changed() {
    clearTimeout(soon);
    soon = setTimeout(async () => {
      if (pane.hidden) return;
      await stage.load();
      things.position();
    }, 60);
  }

  // Shows a value in the place: the mesh, the splats, the camera or the object that a node gives.
  async function reveal(id, type) {
    await stage.load();
    const { scene } = stage;
    if (!scene) return;
    const at = (list, fits) => list.findIndex(fits);
    const [splats, camera] = [at(scene.splats, (one) => one.node === id), at(scene.cameras, (one) => one.id === id || one.node === id)];
    const object = at(scene.objects, (one) => one.node === id || one.pose_id === id);
    if (type === "splats" && splats >= 0) {
      $("place-splats").value = String(splats);
      $("place-cloud").checked = true;
      await stage.splats();
    } else if (type === "mesh" && !$("place-mesh").checked) $("place-mesh").click();
    else if (type === "rig" && camera >= 0) gaze.look(camera);
    else if (object >= 0) { pointer.select(object); gaze.toObject(); }
    redraw();
  }

  return { reveal, open: () => { stage.load().then(things.position); box.focus({ preventScroll: true }); }, changed, key, pictured: () => { if (stage.view && !pane.hidden) overlay(); } };
}
