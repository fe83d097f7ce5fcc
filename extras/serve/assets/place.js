// The place view: the captured place in three dimensions, in which objects and cameras are placed by hand.
import { $, el, framed, number, show } from "./dom.js";
import { bytes, json, post } from "./server.js";
import { add, boxHit, column, distance, dot, length, moved, mul, point, sub, unit, unpacked, View } from "./space.js";
import { alongAxis, handles, Lines, onPlane } from "./gizmo.js";
import { Solid } from "./solid.js";
import { entries } from "./fields.js";

// Ground that is steeper than this is not stood on, as for `Pose(pixel: ..)`.
const STEEP_DEG = 45;
// A drag of fewer pixels is a click.
const CLICK = 4;

// `page` gives the graph (`graph()`), the state (`state()`), the picture of the graph (`picture()`), edits (`set`,
// `attempt`, `revert`), and `choose`, `notify`.
export function Place(page) {
  const [pane, box] = [$("place"), $("space")];
  const solid = Solid($("solid"));
  if (solid.failure) {
    $("space-note").textContent = solid.failure;
    return { open() {}, changed() {}, key: () => false };
  }
  const lines = Lines($("lines"));
  let scene = null;
  let view = null;
  // Size of the captured place: the median distance of the splats from their middle.
  let radius = 1;
  // Lowest and highest splats, without outliers.
  let heights = [0, 1];
  const cut = () => { const t = Number($("place-cut").value); return t >= 1 ? Infinity : heights[0] + t * (heights[1] - heights[0]); };
  let selected = 0;
  let hot = null;
  // A drag, a tool that waits for a click, and the keys of flight that are down.
  let drag = null;
  let tool = null;
  const flying = new Set();
  // The object while it is moved: its matrix, until the results of the edit are there.
  let override = null;
  let spot = null;
  const redraw = framed(draw);

  const metre = () => 1 / scene.metres_per_unit;
  const object = () => scene?.objects[selected];
  const matrix = (one) => (override?.node === one.node ? override.matrix : one.matrix);
  const bounds = (one) => solid.bounds(one.shape);
  const note = (words) => { $("space-note").textContent = words ?? ""; };

  // ---- data

  let loading = null;
  async function load() {
    if (loading) { loading.again = true; return; }
    loading = {};
    try {
      const next = await json("/place");
      if (next) await take(next);
    } catch (error) {
      page.notify(error.message);
    }
    const { again } = loading;
    loading = null;
    if (again) await load();
  }

  // True when the first view has been chosen, or the user has moved it.
  let looked = false;

  // Frees the shapes that nothing uses any more.
  function tidy() {
    const used = [...scene.objects.map((one) => one.shape), ...scene.meshes.map((one) => one.digest)];
    for (const name of shapes.keys()) if (!used.includes(name)) { shapes.delete(name); solid.remove(name); }
  }

  // Of the instances of a node along axes, the one at the place that the page shows, else the first.
  function here(list, id) {
    const shown = page.along().split("/");
    const parts = (one) => id(one).split("/").slice(1);
    const fits = (one) => parts(one).length > 0 && parts(one).every((part) => shown.includes(part));
    const chosen = new Map();
    for (const one of list) {
      const name = `${id(one).split("/")[0]}\n${one.name ?? ""}`;
      if (!chosen.has(name) || (fits(one) && !fits(chosen.get(name)))) chosen.set(name, one);
    }
    return [...chosen.values()];
  }

  async function take(next) {
    next.objects = here(next.objects, (one) => one.node);
    next.cameras = here(next.cameras, (one) => one.id);
    next.probes = here(next.probes, (one) => one.node);
    const first = !scene;
    const before = scene;
    scene = next;
    view ??= new View(next);
    if (before && before.name !== next.name) view.frame = next;
    const settled = override && next.objects.find((one) => one.node === override.node);
    if (!drag && override && (!settled || override.done && String(settled.matrix) !== String(override.before))) override = null;
    selected = Math.max(0, Math.min(selected, next.objects.length - 1));
    menus();
    starting();
    if (first) await splats();
    for (const one of next.objects) await shape(one.shape, `/object/${one.shape}`);
    if ($("place-mesh").checked && mesh()) await shape(mesh().digest, `/mesh/${mesh().digest}`);
    if (!first) await splats();
    tidy();
    if (!looked) {
      look(startCamera());
      looked = scene.cameras.length > 0 && Boolean(solid.cloud());
    }
    redraw();
    // A camera that is looked through follows its node.
    const same = view.camera && next.cameras.find((one) => one.id === view.camera.id && one.name === view.camera.name);
    if (same && view.exact && String(same.matrix) !== String(view.camera.matrix)) look(next.cameras.indexOf(same));
    else if (same) view.camera = same;
    missing();
  }

  function missing() {
    const node = page.graph().nodes?.find((one) => one.kind === "Place" && !scene.objects.some((object) => object.node.split("/")[0] === one.in_file));
    if (!scene.splats.length) note("The graph has no splats yet.");
    else if (node) note(`\`${node.id}\` has no result yet, so its object is not shown.`);
    else if ($("space-note").textContent.includes("yet")) note("");
  }

  const shapes = new Map();
  async function shape(name, path) {
    if (!shapes.has(name)) {
      shapes.set(name, bytes(path).then((buffer) => { solid.mesh(name, unpacked(buffer)); redraw(); }).catch((error) => { shapes.delete(name); page.notify(error.message); }));
    }
    await shapes.get(name);
  }

  let shownSplats = null;
  async function splats() {
    const chosen = scene.splats[Number($("place-splats").value || 0)] ?? scene.splats[0];
    if (!chosen || shownSplats === chosen.digest) return;
    shownSplats = chosen.digest;
    const cloud = solid.splats(unpacked(await bytes(`/splats/${chosen.digest}`)));
    const away = [];
    for (let i = 0; i < cloud.count; i += Math.max(1, cloud.count >> 12)) away.push(Math.hypot(cloud.floats[8 * i], cloud.floats[8 * i + 1], cloud.floats[8 * i + 2]));
    radius = away.sort((a, b) => a - b)[away.length >> 1] || 1;
    const tall = [];
    for (let i = 0; i < cloud.count; i += Math.max(1, cloud.count >> 12)) tall.push(dot([0, 1, 2].map((k) => cloud.floats[8 * i + k] + cloud.origin[k]), scene.up));
    tall.sort((a, b) => a - b);
    heights = [tall[Math.floor(tall.length * 0.02)] ?? 0, tall[Math.floor(tall.length * 0.98)] ?? 1];
    $("splat-count").textContent = cloud.count < cloud.total ? `${cloud.count.toLocaleString("en")} of ${cloud.total.toLocaleString("en")} splats` : `${cloud.count.toLocaleString("en")} splats`;
  }

  const mesh = () => scene.meshes.find((one) => one.receiver) ?? scene.meshes[0];
  // The value that rays of the pointer hit: the mesh that receives shadows, else the splats.
  const ground = () => mesh()?.digest ?? scene.splats[0]?.digest;

  const shownMenus = {};
  function menu(id, options, chosen) {
    const signature = JSON.stringify([options, chosen]);
    if (shownMenus[id] === signature) return;
    shownMenus[id] = signature;
    show($(id), options.map(([value, label]) => el("option", { value, selected: String(value) === String(chosen) }, label)));
  }

  function menus() {
    const at = view?.camera ? scene.cameras.findIndex((one) => one.id === view.camera.id && one.name === view.camera.name) : -1;
    menu("place-view", [["", "free"], ...scene.cameras.map((one, index) => [index, one.name === one.node ? one.node : `${one.id}: ${one.name}`])], at < 0 ? "" : at);
    menu("place-splats", scene.splats.map((one, index) => [index, one.node]), $("place-splats").value || 0);
    menu("place-object", scene.objects.map((one, index) => [index, one.node]), selected);
    $("place-splats-label").hidden = scene.splats.length < 2;
    $("place-object-label").hidden = scene.objects.length < 2;
    $("place-mesh").disabled = !mesh();
    for (const id of ["place-click", "place-drop"]) $(id).disabled = !object();
  }

  // ---- views

  const startCamera = () => Math.max(scene.cameras.findIndex((one) => one.kind === "Camera"), scene.cameras.length ? 0 : -1);
  const middle = () => solid.cloud()?.origin ?? [0, 0, 0];

  function reach(eye, forward) {
    const one = object();
    const depth = one ? dot(sub(foot(one, matrix(one)), eye), forward) : 0;
    return depth > 0 ? depth : radius;
  }

  // Looks through a camera by its index; below 0, freely.
  function look(index) {
    const camera = scene.cameras[index] ?? null;
    $("place-cut").value = 1;
    if (camera) view.through(camera, reach(column(camera.matrix, 3), column(camera.matrix, 2)));
    else if (!view.camera && distance(view.eye, [0, 0, 0]) === 0) overview();
    else { view.free(); view.camera = null; }
    menus();
    redraw();
  }

  function overview() {
    view.free();
    view.camera = null;
    view.target = middle();
    view.eye = add(middle(), add(mul(scene.forward, -1.7 * radius), mul(scene.up, 2.1 * radius)));
    // Without a ceiling, and without what is above the eyes of the first camera.
    const eye = scene.cameras[startCamera()];
    const one = object();
    if (eye) {
      const top = Math.max(dot(column(eye.matrix, 3), scene.up), one ? dot(corners(one, matrix(one))[1], scene.up) : -Infinity);
      $("place-cut").value = (top + 0.05 * radius - heights[0]) / (heights[1] - heights[0] || 1);
    }
    menus();
    redraw();
  }

  function toObject() {
    const one = object();
    if (!one) return overview();
    view.free();
    const size = Math.max(length(sub(...corners(one, matrix(one)))), 1e-9);
    const centre = add(foot(one, matrix(one)), mul(scene.up, size * 0.3));
    const back = unit(sub(view.eye, centre));
    view.target = centre;
    view.eye = add(centre, mul(length(back) ? back : mul(scene.forward, -1), 2.2 * size));
    redraw();
    return null;
  }

  // ---- objects

  // The lowest and the highest corner of an object in the world, along the axes of the world.
  function corners(one, m) {
    const known = bounds(one);
    const origin = column(m, 3);
    if (!known) return [origin, origin];
    const all = Array.from({ length: 8 }, (_, i) => point(m, [0, 1, 2].map((k) => ((i >> k) & 1 ? known.high[k] : known.low[k]))));
    return [Math.min, Math.max].map((pick) => [0, 1, 2].map((k) => pick(...all.map((p) => p[k]))));
  }

  // The middle of the lowest side.
  function foot(one, m) {
    const [low, high] = corners(one, m);
    const centre = mul(add(low, high), 0.5);
    const lowest = Math.min(dot(low, scene.up), dot(high, scene.up));
    return add(centre, mul(scene.up, lowest - dot(centre, scene.up)));
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

  const decimals = () => Math.max(0, Math.min(12, 4 + Math.ceil(Math.log10(scene.metres_per_unit) - 1e-9)));
  function ron(value, digits) {
    const text = String(Number(value.toFixed(digits)) || 0);
    return /[.e]/.test(text) ? text : `${text}.0`;
  }

  // The edit of a pose that a change of the object makes.
  function editOf(start, { radians = 0, k = 1, way = [0, 0, 0] }) {
    const { node, vector, yaw, scale } = start.pose;
    const parts = [];
    if (length(way) > 0) {
      const next = add(vector, way).map((v) => ron(v, decimals()));
      const text = node.values.translation?.text;
      if (!text || entries(text)) parts.push({ field: "translation", at: [], value: `(${next.join(", ")})` });
      else next.forEach((value, i) => { if (way[i]) parts.push({ field: "translation", at: [i], value }); });
    }
    if (radians) parts.push({ field: "yaw_deg", at: [], value: ron(wrapped(yaw + (radians * 180) / Math.PI), 1) });
    if (k !== 1) parts.push({ field: "scale", at: [], value: ron(scale * k, Math.max(0, 3 - Math.floor(Math.log10(Math.abs(scale * k))))) });
    if (!parts.length) return null;
    const [first, ...also] = parts;
    return { node: node.in_file, ...first, also };
  }

  const wrapped = (degrees) => ((((degrees + 180) % 360) + 360) % 360) - 180;

  function grab(one) {
    const m = matrix(one);
    return { one, matrix: m, centre: column(m, 3), foot: foot(one, m), pose: pose(one), change: {} };
  }

  // Moves the object on the screen, and tries the value.
  function preview(start, change) {
    start.change = change;
    override = { node: start.one.node, matrix: moved(start.matrix, start.centre, { axis: scene.up, ...change }), before: start.one.matrix, done: false };
    const edit = editOf(start, change);
    if (edit) page.attempt(edit);
    position();
    redraw();
  }

  async function commit(start) {
    const edit = editOf(start, start.change);
    if (!edit) { override = null; page.revert(); redraw(); return; }
    const { radians = 0, k = 1, way = [0, 0, 0] } = start.change;
    const { vector, yaw, scale } = start.pose;
    written = { id: start.one.pose_id, graph: page.graph(), values: { vector: add(vector, way), yaw: wrapped(yaw + (radians * 180) / Math.PI), scale: scale * k } };
    const good = await page.set(edit);
    if (good === null) { [override, written] = [null, null]; redraw(); return; }
    if (override) override.done = true;
    // Without a new result, for instance if its node fails, the object goes back to the last one.
    setTimeout(() => { if (override?.done && !drag) { override = null; load(); } }, 4000);
    load();
  }

  function cancel(start) {
    override = null;
    drag = null;
    page.revert();
    position();
    redraw();
    if (start) note("");
  }

  // ---- the ground; one question at a time, the last one wins

  let asking = null;
  function ask(ray, answer) {
    const next = { ray, answer };
    if (asking) { asking.next = next; return; }
    asking = next;
    (async () => {
      while (asking) {
        const { ray: [eye, way], answer: give } = asking;
        let found;
        try { found = await post("/ground", { digest: ground(), eye, way, focal_px: view.lens().fy }); } catch (error) { found = { position: null, why: error.message }; }
        const { next: later } = asking;
        asking = later ?? null;
        give(found);
      }
    })();
  }

  const below = (start, way, answer) => {
    const [low, high] = corners(start.one, start.matrix);
    const over = Math.max(0.25 * Math.abs(dot(sub(high, low), scene.up)), 0.05 * metre());
    ask([add(add(start.foot, way), mul(scene.up, over)), mul(scene.up, -1)], answer);
  };

  function stands(found) {
    if (!found.position) { note(found.why); return false; }
    if (found.steep_deg > STEEP_DEG) { note(`The surface there is ${Math.round(found.steep_deg)} degrees steep, too steep to stand on.`); return false; }
    note("");
    return true;
  }

  // Puts the foot of the object on the ground that a ray hits.
  const onto = (start, ray, then) => ask(ray, (found) => {
    if (drag && drag.start !== start) return;
    if (!stands(found)) return;
    spot = found.position;
    preview(start, { ...start.change, way: sub(found.position, start.foot) });
    then?.();
  });

  function drop() {
    const [one] = [object()];
    const why = fixed(one);
    if (why) return note(why);
    const start = grab(one);
    return below(start, [0, 0, 0], (found) => {
      if (!stands(found)) return;
      preview(start, { way: sub(found.position, start.foot) });
      commit(start);
    });
  }

  // ---- drags

  const where = (event) => { const rect = box.getBoundingClientRect(); return [event.clientX - rect.left, event.clientY - rect.top]; };

  // The object under a point of the pane.
  function under(p) {
    const way = view.ray(...p);
    let best = null;
    scene.objects.forEach((one, index) => {
      const known = bounds(one);
      const away = known ? boxHit(matrix(one), known.low, known.high, view.eye, way) : Infinity;
      if (Number.isFinite(away) && away < (best?.away ?? Infinity)) best = { index, away };
    });
    return best?.index ?? null;
  }

  function moveObject(p, event) {
    const { start, kind, from } = drag;
    const way = view.ray(...p);
    if (kind === "body") {
      const aim = [p[0] + drag.offset[0], p[1] + drag.offset[1]];
      const ray = [view.eye, view.ray(...aim)];
      if ($("place-snap").checked) return onto(start, ray);
      const hit = onPlane(start.foot, scene.up, ...ray);
      return hit && preview(start, { way: sub(hit, start.foot) });
    }
    if (kind === "ring") {
      const angle = (q) => {
        const hit = onPlane(start.centre, scene.up, view.eye, view.ray(...q));
        return hit ? Math.atan2(dot(sub(hit, start.centre), scene.forward), dot(sub(hit, start.centre), scene.right)) : null;
      };
      const [a, b] = [angle(from), angle(p)];
      let radians = a === null || b === null ? ((p[0] - from[0]) * Math.PI) / 200 : b - a;
      if (event.shiftKey) {
        const step = Math.PI / 12;
        const yaw = (start.pose.yaw * Math.PI) / 180;
        radians = Math.round((yaw + radians) / step) * step - yaw;
      }
      return preview(start, { radians });
    }
    if (kind === "scale") {
      const at = view.project(start.centre);
      const ratio = Math.hypot(p[0] - at[0], p[1] - at[1]) / Math.max(8, Math.hypot(from[0] - at[0], from[1] - at[1]));
      return preview(start, { k: Math.max(0.01, ratio) });
    }
    const axis = handles(scene).find(([name]) => name === kind)[1];
    const along = alongAxis(start.centre, axis, view.eye, way) - alongAxis(start.centre, axis, view.eye, view.ray(...from));
    const shift = mul(axis, along);
    if (kind === "up" || !$("place-snap").checked) return preview(start, { way: shift });
    return below(start, shift, (found) => {
      if (drag?.start !== start) return;
      const lift = stands(found) ? dot(sub(found.position, add(start.foot, shift)), scene.up) : 0;
      spot = found.position;
      preview(start, { way: add(shift, mul(scene.up, lift)) });
    });
  }

  box.addEventListener("pointerdown", (event) => {
    if (!scene || event.target.closest("#start")) return;
    box.focus({ preventScroll: true });
    looked = true;
    const p = where(event);
    box.setPointerCapture(event.pointerId);
    const part = event.button === 0 && !tool ? lines.hit(p) : null;
    drag = { kind: event.button === 0 && !event.shiftKey ? "orbit" : "pan", from: p, last: p, button: event.button };
    if (!tool && part?.kind === "camera") drag.camera = part.index;
    else if (!tool && event.button === 0) {
      const body = part ? null : under(p);
      if (body !== null && body !== selected) { selected = body; menus(); }
      if (part || body !== null) {
        const why = fixed(object());
        if (why) note(why);
        else {
          drag.kind = part?.kind ?? "body";
          drag.start = grab(object());
          const at = view.project(drag.start.foot);
          drag.offset = at ? [at[0] - p[0], at[1] - p[1]] : [0, 0];
        }
      }
    }
  });

  box.addEventListener("pointermove", (event) => {
    if (!scene) return;
    const p = where(event);
    if (!drag) {
      const part = tool ? null : lines.hit(p)?.kind ?? (under(p) === null ? null : "body");
      if (part !== hot) { hot = part; redraw(); }
      box.style.cursor = tool ? "crosshair" : part ? "pointer" : "grab";
      return;
    }
    if (!drag.going && Math.hypot(p[0] - drag.from[0], p[1] - drag.from[1]) < CLICK) return;
    drag.going = true;
    const [dx, dy] = [p[0] - drag.last[0], p[1] - drag.last[1]];
    drag.last = p;
    if (drag.start) return void moveObject(p, event);
    if (drag.kind === "pan" || drag.button > 0) {
      const k = distance(view.eye, view.target) / view.lens().fy;
      view.pan(dx * k, dy * k);
    } else {
      view.orbit((dx * Math.PI) / 500, (dy * Math.PI) / 500);
    }
    coarse();
    redraw();
  });

  box.addEventListener("pointerup", (event) => {
    const ended = drag;
    drag = null;
    if (!ended) return;
    if (ended.going) redraw();
    if (ended.going) { if (ended.start) settle(ended.start); return; }
    if (ended.camera !== undefined) return void look(ended.camera);
    const p = where(event);
    if (ended.start) { page.choose(ended.start.one.pose_id); redraw(); return; }
    if (tool) return void tool(p);
    if (ended.button === 0) ask([view.eye, view.ray(...p)], (found) => {
      if (!found.position) return;
      // The view turns about what was clicked.
      spot = found.position;
      view.free();
      const forward = view.axes()[2];
      const depth = dot(sub(found.position, view.eye), forward);
      if (depth > 0) view.target = add(view.eye, mul(forward, depth));
      position();
      redraw();
    });
  });
  box.addEventListener("pointercancel", () => { if (drag?.start) cancel(drag.start); drag = null; });
  box.addEventListener("contextmenu", (event) => event.preventDefault());

  // Writes the end of a drag, after the last answer about the ground.
  function settle(start) {
    const write = () => { if (asking) setTimeout(write, 10); else commit(start); };
    write();
  }

  box.addEventListener("wheel", (event) => {
    if (!scene) return;
    event.preventDefault();
    looked = true;
    view.dolly(2 ** (event.deltaY / (event.deltaMode ? 12 : 500)));
    coarse();
    redraw();
  }, { passive: false });

  // ---- placing by a click

  function wait(next) {
    tool = next;
    $("place-click").setAttribute("aria-pressed", String(Boolean(next)));
    note(next ? "Click where the object shall stand. Escape: leave." : "");
    box.style.cursor = next ? "crosshair" : "grab";
  }

  function placeByClick() {
    if (tool) return wait(null);
    const why = fixed(object());
    if (why) return note(why);
    return wait((p) => {
      const start = grab(object());
      onto(start, [view.eye, view.ray(...p)], () => { wait(null); commit(start); });
    });
  }

  // ---- an object for a bare capture

  let panel = "";
  function starting() {
    const signature = JSON.stringify(scene.start);
    if (signature === panel) return;
    panel = signature;
    $("start").hidden = !scene.start;
    if (!scene.start) return;
    const { proposals, objects } = scene.start;
    const list = el("select", { id: "start-object", "aria-label": "Object" }, objects.map((name) => el("option", { value: name }, name)));
    show($("start"), el("h3", {}, "Put an object into the place"),
      objects.length ? el("p", {}, list, " ", el("button", { id: "start-click", type: "button", onclick: stand }, "Click the floor"))
        : el("p", {}, "There is no .glb or .gltf file in the folder of the graph or of the capture. Copy one there, and open this page again."),
      el("p", { class: "dim" }, "The camera of the picture will be where you look from."),
      el("dl", {}, proposals.map(({ what, value }) => [el("dt", {}, what), el("dd", {}, value)]).flat()));
  }

  // Waits for a click on the floor, and writes a graph with the object there and the camera as the view is.
  function stand() {
    if (tool) return wait(null);
    const object = $("start-object").value;
    return wait((p) => {
      const [left, top, width, height] = view.rectangle();
      const inside = p[0] >= left && p[0] <= left + width && p[1] >= top && p[1] <= top + height;
      if (!inside) return note("That is outside the picture; turn the view so that it lies inside the frame.");
      return ask([view.eye, view.ray(...p)], (found) => stands(found) && begin(object, found));
    });
  }

  async function begin(object, found) {
    spot = found.position;
    wait(null);
    redraw();
    note("Measuring the light and writing the graph ..");
    const { fy } = view.lens();
    const fov = (360 / Math.PI) * Math.atan(view.rectangle()[3] / 2 / fy);
    const rounded = (v) => v.map((one) => Number(one.toFixed(decimals())));
    const forward = view.axes()[2];
    // The point in the middle of the picture, at the distance of the object.
    const target = add(view.eye, mul(forward, Math.max(1e-3 * radius, dot(sub(found.position, view.eye), forward))));
    await page.start({ object, stand: { place: found.position, eye: rounded(view.eye), target: rounded(target), fov_y_deg: Number(fov.toFixed(2)) } });
    note("");
    spot = null;
    follow = view.camera;
    load();
  }

  // ---- cameras

  // The reason why the camera of the view cannot be set; null if it can.
  function cameraFixed() {
    const { camera } = view;
    if (!camera) return "Look through a camera first.";
    if (camera.kind !== "Camera") return `\`${camera.node}\` is a \`${camera.kind}\`, which is not given by eye and target.`;
    return page.graph().confined ? "This graph belongs to an unpacked bundle, whose files are never written." : null;
  }

  async function setCamera() {
    const why = cameraFixed();
    if (why || view.exact) return note(why ?? "The camera is where the view is.");
    const text = (p) => `(${p.map((v) => ron(v, decimals())).join(", ")})`;
    const node = page.graph().nodes.find((one) => one.id === view.camera.id);
    const roll = Number(node?.values.roll_deg?.value ?? 0);
    const also = [{ field: "target", at: [], value: text(view.target) }];
    if (roll) also.push({ field: "roll_deg", at: [], value: "0.0" });
    const good = await page.set({ node: view.camera.node, field: "eye", at: [], value: text(view.eye), also });
    if (good !== null) { follow = view.camera; load(); }
    return null;
  }
  // The camera that was set, until its new value is there.
  let follow = null;

  // ---- keys

  const FLIGHT = { w: [0, 0, 1], s: [0, 0, -1], a: [-1, 0, 0], d: [1, 0, 0], e: [0, 1, 0], q: [0, -1, 0] };
  let flightAt = 0;
  function fly() {
    const now = performance.now();
    const seconds = Math.min(0.1, (now - flightAt) / 1000);
    flightAt = now;
    if (!flying.size) return;
    const speed = 0.6 * radius * seconds;
    const sum = [...flying].reduce((way, key) => add(way, FLIGHT[key]), [0, 0, 0]);
    view.fly(...mul(sum, speed));
    coarse();
    redraw();
    requestAnimationFrame(fly);
  }

  // Steps of an object by keys are written when no key has come for a while.
  let stepping = null;
  function step(change) {
    const why = fixed(object());
    if (why) return note(why);
    clearTimeout(stepping?.timer);
    stepping ??= { start: grab(object()) };
    const { start } = stepping;
    const { radians = 0, way = [0, 0, 0] } = start.change;
    preview(start, { radians: radians + (change.radians ?? 0), way: add(way, change.way ?? [0, 0, 0]) });
    stepping.timer = setTimeout(() => { const ended = stepping; stepping = null; commit(ended.start); }, 450);
    return null;
  }

  // The horizontal axis of the world that is nearest to a direction.
  function level(direction) {
    const sides = [scene.right, scene.forward, mul(scene.right, -1), mul(scene.forward, -1)];
    return sides.reduce((best, axis) => (dot(axis, direction) > dot(best, direction) + 1e-9 ? axis : best));
  }

  function key(event) {
    if (!scene || event.ctrlKey || event.metaKey || event.altKey) return false;
    const name = event.key.toLowerCase();
    if (FLIGHT[name]) {
      if (!flying.size) { flightAt = performance.now(); requestAnimationFrame(fly); }
      flying.add(name);
      return true;
    }
    const reachOf = (event.shiftKey ? 0.1 : 0.01) * metre();
    const [right, , forward] = view.axes();
    const ahead = level(sub(forward, mul(scene.up, dot(forward, scene.up))));
    const action = {
      arrowright: () => step({ way: mul(level(right), reachOf) }), arrowleft: () => step({ way: mul(level(right), -reachOf) }),
      arrowup: () => step({ way: mul(ahead, reachOf) }), arrowdown: () => step({ way: mul(ahead, -reachOf) }),
      pageup: () => step({ way: mul(scene.up, reachOf) }), pagedown: () => step({ way: mul(scene.up, -reachOf) }),
      ",": () => step({ radians: Math.PI / 36 }), ".": () => step({ radians: -Math.PI / 36 }),
      g: drop, x: placeByClick, c: () => look((Number($("place-view").value || -1) + 1) % Math.max(1, scene.cameras.length)),
      0: overview, f: toObject, o: () => { onion($("place-onion").value > 0 ? 0 : 1); }, enter: setCamera,
      "+": () => { view.dolly(0.8); redraw(); }, "-": () => { view.dolly(1.25); redraw(); },
      escape: () => { if (drag?.start) cancel(drag.start); else if (stepping) { clearTimeout(stepping.timer); cancel(stepping.start); stepping = null; } else wait(null); },
    }[name];
    if (!action) return false;
    action();
    return true;
  }
  document.addEventListener("keyup", (event) => flying.delete(event.key.toLowerCase()));
  window.addEventListener("blur", () => flying.clear());

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
    if (!scene || pane.hidden || !view) return;
    view.size = [box.clientWidth, box.clientHeight];
    if (!view.size[0] || !view.size[1]) return;
    const objects = scene.objects.filter((one) => solid.has(one.shape)).map((one) => [one.shape, matrix(one)]);
    const solids = $("place-objects").checked ? objects : [];
    const ghost = $("place-mesh").checked ? mesh()?.digest : null;
    const near = Math.min(0.2 * metre(), 0.05 * radius);
    const moves = Boolean(drag?.going || flying.size || resting);
    const { scale, stride } = moves ? detail() : { scale: 1, stride: 1 };
    const took = solid.draw(view, { solids, ghost, showSplats: $("place-cloud").checked, scale: radius, near, cut: cut(), ratio: devicePixelRatio * scale, stride, timed: !moves });
    cost = took ?? cost;
    lines.begin(view, devicePixelRatio);
    if (view.camera) lines.mask();
    if ($("place-guides").checked) {
      scene.cameras.forEach((one, index) => {
        // Near ones are small, so that they do not cover the place.
        const away = distance(column(one.matrix, 3), view.eye);
        if (!(view.exact && one === view.camera) && away > 0.02 * radius) lines.camera(one, index, Math.min(0.12 * radius, 0.15 * away), one.kind === "Camera");
      });
      scene.probes.forEach((one) => lines.probe(one, 0.04 * radius));
      lines.mark(spot);
      const one = object();
      if (one && !fixed(one)) {
        const m = matrix(one);
        if (drag?.start && spot) { const [low, high] = corners(one, m); lines.contact(foot(one, m), spot, 0.35 * distance(low, high)); }
        // The front of a file of glTF is +z.
        const front = sub(column(m, 2), mul(scene.up, dot(column(m, 2), scene.up)));
        lines.gizmo(column(m, 3), unit(length(front) > 1e-12 * length(column(m, 2)) ? front : mul(scene.forward, -1)), drag?.start ? drag.kind : hot);
      }
    }
    lines.triad();
    overlay();
    const why = cameraFixed();
    $("place-set").hidden = view.camera?.kind !== "Camera";
    $("place-set").disabled = Boolean(why) || view.exact;
    $("place-set").textContent = "Set camera";
    $("place-set").title = why ?? (view.exact ? "Move the view first" : `Writes eye and target of \`${view.camera?.node}\` (Enter)`);
  }

  function position() {
    const one = object();
    if (!one) { $("place-position").textContent = ""; return; }
    const known = pose(one);
    const short = (p) => p.map((v) => number(Number(v.toFixed(decimals())))).join(", ");
    const at = short(column(matrix(one), 3));
    const yaw = known ? ` · yaw ${number(Number(wrapped(known.yaw).toFixed(1)))}°` : "";
    $("place-position").textContent = `${one.node} at (${at})${yaw}${spot ? ` · ground at (${short(spot)})` : ""}`;
  }

  // The traced picture, over the view of its camera or in the corner.
  let pictured = "";
  function overlay() {
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
    if (value > 0 && view.camera && !view.exact) look(scene.cameras.indexOf(view.camera));
    redraw();
  }

  $("place-view").addEventListener("change", () => look($("place-view").value === "" ? -1 : Number($("place-view").value)));
  $("place-splats").addEventListener("change", () => splats().then(redraw));
  $("place-object").addEventListener("change", () => { selected = Number($("place-object").value); page.choose(object().pose_id ?? object().node); redraw(); });
  $("place-mesh").addEventListener("change", async () => { if (mesh()) await shape(mesh().digest, `/mesh/${mesh().digest}`); redraw(); });
  $("place-cut").addEventListener("input", redraw);
  for (const id of ["place-cloud", "place-objects", "place-guides", "place-corner"]) $(id).addEventListener("change", redraw);
  $("place-onion").addEventListener("input", () => onion(Number($("place-onion").value)));
  $("place-click").addEventListener("click", placeByClick);
  $("place-drop").addEventListener("click", drop);
  $("place-set").addEventListener("click", setCamera);
  $("place-all").addEventListener("click", overview);
  new ResizeObserver(redraw).observe(box);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  $("solid").addEventListener("webglcontextlost", (event) => { event.preventDefault(); note("The graphics driver stopped; open the page again."); });

  // Results come in bursts.
  let soon = null;
  function changed() {
    clearTimeout(soon);
    soon = setTimeout(async () => {
      if (pane.hidden) return;
      await load();
      const now = follow && scene.cameras.find((one) => one.id === follow.id && one.name === follow.name);
      if (now && String(now.matrix) !== String(follow.matrix) && view.camera?.id === now.id) { follow = null; look(scene.cameras.indexOf(now)); }
      position();
    }, 60);
  }

  return { open: () => { load().then(position); box.focus({ preventScroll: true }); }, changed, key, redraw };
}
