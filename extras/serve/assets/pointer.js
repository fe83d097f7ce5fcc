// The pointer in the place view: turns the view, moves objects by their gizmo, and places them by a click.
import { $ } from "./dom.js";
import { alongAxis, handles, onPlane } from "./gizmo.js";
import { add, boxHit, distance, dot, mul, sub } from "./space.js";

// A drag of fewer pixels is a click.
const CLICK = 4;

export function Pointer(stage, things, gaze, lines, moving) {
  const { page, note, redraw } = stage;
  const box = $("space");
  // The part of the gizmo under the pointer.
  let hot = null;

  const where = (event) => { const rect = box.getBoundingClientRect(); return [event.clientX - rect.left, event.clientY - rect.top]; };

  // The index of the object under a point of the pane.
  function under(p) {
    const way = stage.view.ray(...p);
    let best = null;
    stage.scene.objects.forEach((one, index) => {
      const known = stage.bounds(one);
      const away = known ? boxHit(stage.matrix(one), known.low, known.high, stage.view.eye, way) : Infinity;
      if (Number.isFinite(away) && away < (best?.away ?? Infinity)) best = { index, away };
    });
    return best?.index ?? null;
  }

  // Makes an object the one that the gizmo moves.
  function select(index) {
    if (index === stage.selected || !stage.scene.objects[index]) return;
    things.unstep();
    [stage.selected, stage.spot] = [index, null];
    stage.menus();
    things.position();
    redraw();
  }

  function turned({ start, from }, p, event) {
    const { scene, view } = stage;
    const angle = (q) => {
      const hit = onPlane(start.centre, scene.up, view.eye, view.ray(...q));
      return hit ? Math.atan2(dot(sub(hit, start.centre), scene.forward), dot(sub(hit, start.centre), scene.right)) : null;
    };
    const [a, b] = [angle(from), angle(p)];
    const radians = a === null || b === null ? ((p[0] - from[0]) * Math.PI) / 200 : b - a;
    if (!event.shiftKey) return radians;
    const step = Math.PI / 12;
    const yaw = (start.pose.yaw * Math.PI) / 180;
    return Math.round((yaw + radians) / step) * step - yaw;
  }

  function moveObject(p, event) {
    const { scene, view, drag } = stage;
    const { start, kind, from } = drag;
    if (kind === "body") {
      const ray = [view.eye, view.ray(p[0] + drag.offset[0], p[1] + drag.offset[1])];
      if ($("place-snap").checked) return things.onto(start, ray);
      const hit = onPlane(start.foot, scene.up, ...ray);
      return hit && things.preview(start, { way: sub(hit, start.foot) });
    }
    if (kind === "ring") return things.preview(start, { radians: turned(drag, p, event) });
    if (kind === "scale") {
      const at = view.project(start.centre);
      const ratio = Math.hypot(p[0] - at[0], p[1] - at[1]) / Math.max(8, Math.hypot(from[0] - at[0], from[1] - at[1]));
      return things.preview(start, { k: Math.max(0.01, ratio) });
    }
    const axis = handles(scene).find(([name]) => name === kind)[1];
    const along = (q) => alongAxis(start.centre, axis, view.eye, view.ray(...q));
    const shift = mul(axis, along(p) - along(from));
    if (kind === "up" || !$("place-snap").checked) return things.preview(start, { way: shift });
    return things.ground.below(start, shift, (found) => {
      if (stage.drag?.start !== start) return;
      const lift = things.ground.stands(found) ? dot(sub(found.position, add(start.foot, shift)), scene.up) : 0;
      stage.spot = found.position;
      things.preview(start, { way: add(shift, mul(scene.up, lift)) });
    });
  }

  box.addEventListener("pointerdown", (event) => {
    if (!stage.scene || event.target.closest("#start, #add, #ruler")) return;
    box.focus({ preventScroll: true });
    stage.looked = true;
    const p = where(event);
    box.setPointerCapture(event.pointerId);
    const grabs = event.button === 0 && !stage.tool;
    const part = grabs ? lines.hit(p) : null;
    const drag = { kind: event.button === 0 && !event.shiftKey ? "orbit" : "pan", from: p, last: p, button: event.button };
    stage.drag = drag;
    if (part?.kind === "camera") drag.camera = part.index;
    else if (part?.kind === "tag") drag.tag = part.index;
    else if (grabs) {
      const body = part ? null : under(p);
      if (body !== null) select(body);
      if (!part && body === null) return;
      const why = things.fixed(stage.object());
      if (why) return void note(why);
      drag.kind = part?.kind ?? "body";
      drag.start = things.grab(stage.object());
      const at = stage.view.project(drag.start.foot);
      drag.offset = at ? [at[0] - p[0], at[1] - p[1]] : [0, 0];
    }
  });

  function hover(p) {
    const part = stage.tool ? null : lines.hit(p);
    const kind = part ? part.kind : stage.tool || under(p) === null ? null : "body";
    const next = kind === "camera" ? `camera ${part.index}` : kind;
    if (next !== hot) {
      hot = next;
      redraw();
      if (kind && !["camera", "tag"].includes(kind)) things.foresee();
      else page.plan(null);
    }
    box.style.cursor = stage.tool ? "crosshair" : kind ? "pointer" : "grab";
  }

  box.addEventListener("pointermove", (event) => {
    if (!stage.scene) return;
    const { view, drag } = stage;
    const p = where(event);
    if (stage.aim) { stage.aim = null; redraw(); }
    if (!drag) return hover(p);
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
    moving();
    redraw();
  });

  box.addEventListener("pointerup", (event) => {
    const ended = stage.drag;
    stage.drag = null;
    if (!ended) return;
    if (ended.going) {
      redraw();
      if (ended.start) things.settle(ended.start);
      return;
    }
    const p = where(event);
    if (ended.camera !== undefined) gaze.look(ended.camera);
    else if (ended.tag !== undefined) { select(ended.tag); page.choose(stage.object().pose_id ?? stage.object().node); }
    else if (ended.start) { page.choose(ended.start.one.pose_id); redraw(); }
    else if (stage.tool) stage.tool(p);
    else if (ended.button === 0) turnAbout(p);
  });

  // The view turns about the surface that was clicked.
  function turnAbout(p) {
    const { view } = stage;
    things.ground.ask([view.eye, view.ray(...p)], (found) => {
      if (!found.position) return;
      stage.spot = found.position;
      view.free();
      const forward = view.axes()[2];
      const depth = dot(sub(found.position, view.eye), forward);
      if (depth > 0) view.target = add(view.eye, mul(forward, depth));
      things.position();
      redraw();
    });
  }

  box.addEventListener("pointercancel", () => { if (stage.drag?.start) things.cancel(); stage.drag = null; });
  box.addEventListener("contextmenu", (event) => event.preventDefault());
  box.addEventListener("wheel", (event) => {
    if (!stage.scene) return;
    event.preventDefault();
    stage.looked = true;
    stage.view.dolly(2 ** (event.deltaY / (event.deltaMode ? 12 : 500)));
    moving();
    redraw();
  }, { passive: false });

  // Makes the next clicks on the place call `tool` with the point of the pane; null ends that.
  // With keys, the point is chosen by the arrows and Enter.
  function wait(tool, words = "Click where the object shall stand, or aim with the arrow keys and press Enter. Escape: leave.") {
    stage.tool = tool;
    stage.aim = tool ? stage.view.size.map((v) => v / 2) : null;
    if (tool) box.focus({ preventScroll: true });
    redraw();
    for (const id of ["place-click", "place-measure"]) $(id).setAttribute("aria-pressed", "false");
    // The panels would cover the place that is to be clicked.
    box.classList.toggle("aiming", Boolean(tool));
    for (const id of ["start-click", "add-click"]) if ($(id)) $(id).textContent = tool ? "Cancel" : "Click the floor";
    note(tool ? words : "");
    box.style.cursor = tool ? "crosshair" : "grab";
  }

  function placeByClick() {
    if (stage.tool) return wait(null);
    const why = things.fixed(stage.object());
    if (why) return note(why);
    wait((p) => {
      const start = things.grab(stage.object());
      things.onto(start, [stage.view.eye, stage.view.ray(...p)], () => { wait(null); things.commit(start); });
    });
    return $("place-click").setAttribute("aria-pressed", "true");
  }

  // Moves the point that keys have chosen, or clicks it; false for other keys.
  function aim(event) {
    if (!stage.tool) return false;
    const by = event.shiftKey ? 40 : 8;
    const way = { ArrowRight: [by, 0], ArrowLeft: [-by, 0], ArrowUp: [0, -by], ArrowDown: [0, by] }[event.key];
    if (!way && !["Enter", " "].includes(event.key)) return false;
    stage.aim ??= stage.view.size.map((v) => v / 2);
    if (way) stage.aim = stage.aim.map((v, k) => Math.min(stage.view.size[k] - 1, Math.max(0, v + way[k])));
    else stage.tool(stage.aim);
    redraw();
    return true;
  }

  return { wait, placeByClick, select, aim, hot: () => hot };
}
