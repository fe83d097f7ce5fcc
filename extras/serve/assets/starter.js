// The panel that puts an object into a bare capture.
import { $, el, fileLabel, number, show } from "./dom.js";
import { scaleText } from "./fields.js";
import { add, dot, mul, sub } from "./space.js";

export function Starter(stage, things, pointer) {
  const { page, note } = stage;
  let shown = "";
  // The object that was chosen in the list.
  let wanted = "";
  // True from the writing of the first graph until its object is shown.
  let fresh = false;
  // True while the server turns the place.
  let turning = false;

  function draw() {
    const { start, metres_per_unit: scale } = stage.scene;
    const signature = JSON.stringify([start, scale]);
    // A chosen axis that was undone before its graph was here leaves the same description, but the list shows the axis.
    const other = start && !turning && $("start-up") && $("start-up").value !== (start.up ?? "");
    if (signature === shown && !other) return;
    shown = signature;
    $("start").hidden = !start;
    if (!start) return;
    const { proposals, objects, up, axes } = start;
    const list = el("select", { id: "start-object", "aria-label": "Object" }, objects.map((name) => el("option", { value: name, selected: name === wanted }, fileLabel(name))));
    list.addEventListener("change", () => { wanted = list.value; });
    const option = (axis) => el("option", { value: axis, selected: axis === up }, axis);
    const turn = el("select", { id: "start-up", onchange: () => turned(turn.value) },
      !up && el("option", { value: "", selected: true }, "as measured"), axes.map(option));
    const metres = el("input", { id: "start-scale", type: "text", inputmode: "decimal", value: number(scale), spellcheck: "false", onchange: () => scaled(metres.value) });
    const focus = document.activeElement?.closest?.("#start")?.querySelector(":focus")?.id;
    show($("start"), el("h3", {}, "Put an object into the place"),
      objects.length ? el("p", { class: "tool" }, list, el("button", { id: "start-click", type: "button", onclick: stand }, "Click the floor"))
        : el("p", {}, "There is no .glb or .gltf file in the folder of the graph or of the capture. Copy one there, and come back to this page."),
      el("p", { class: "dim" }, "Drag to turn the view, with the right button to pan; wheel: nearer. The picture shows the place as you look at it now."),
      el("p", {}, el("label", { title: "If the place is tilted or upside down, choose another axis of the file" }, "Up ", turn), " ",
        el("label", { title: "Metres per unit of the file. Measure something whose length you know, or type the number" }, "Scale ", metres, " m per unit")),
      el("dl", {}, proposals.map(({ what, value }) => [el("dt", {}, what), el("dd", {}, value)]).flat()));
    if (focus) $(focus)?.focus();
  }

  // Writes a graph in which another axis of the capture points up. The camera is then another one.
  async function turned(axis) {
    note("Turning the place ..");
    turning = true;
    const good = await page.turn(axis);
    turning = false;
    note("");
    if (good === null) shown = "";
    else stage.looked = false;
    stage.load();
  }

  async function scaled(text) {
    const value = Number(text.replace(",", "."));
    if (!(value > 0) || !Number.isFinite(value)) return note("The scale must be a number of metres above 0.");
    return page.set({ node: "scene", field: "metres_per_unit", at: [], value: scaleText(value) });
  }

  // Waits for a click on the floor, and writes a graph with the object there and the camera as the view is.
  function stand() {
    if (stage.tool) return pointer.wait(null);
    const object = $("start-object").value;
    const { view } = stage;
    return pointer.wait((p) => {
      const [left, top, width, height] = view.rectangle();
      const inside = p[0] >= left && p[0] <= left + width && p[1] >= top && p[1] <= top + height;
      if (!inside) return note("That is outside the picture; turn the view so that it lies inside the frame.");
      return things.ground.ask([view.eye, view.ray(...p)], (found) => things.ground.stands(found) && begin(object, found));
    });
  }

  async function begin(object, found) {
    const { view } = stage;
    stage.spot = found.position;
    pointer.wait(null);
    stage.redraw();
    note("Measuring the light and writing the graph ..");
    const { fy } = view.lens();
    const fov = (360 / Math.PI) * Math.atan(view.rectangle()[3] / 2 / fy);
    const rounded = (v) => v.map((one) => Number(one.toFixed(stage.decimals())));
    const forward = view.axes()[2];
    // The point in the middle of the picture, at the distance of the object.
    const target = add(view.eye, mul(forward, Math.max(1e-3 * stage.radius, dot(sub(found.position, view.eye), forward))));
    const good = await page.start({ object, stand: { place: found.position, eye: rounded(view.eye), target: rounded(target), fov_y_deg: Number(fov.toFixed(2)) } });
    note("");
    fresh = good !== null;
    stage.spot = null;
    stage.follow = view.camera;
    stage.load();
  }

  // What can be done with the object, when it is there for the first time.
  function greet() {
    const one = stage.object();
    if (!fresh || !one || !stage.bounds(one)) return;
    fresh = false;
    const { view } = stage;
    const [left, top, width, height] = view.rectangle();
    const [low, high] = things.corners(one, stage.matrix(one));
    const corners = Array.from({ length: 8 }, (_, i) => view.project([0, 1, 2].map((k) => ((i >> k) & 1 ? high : low)[k])));
    const inside = corners.every((at) => at && at[0] > left && at[0] < left + width && at[1] > top && at[1] < top + height);
    note(inside ? "Drag the object to move it, the ring to turn it, the white square to scale it. The picture in the corner follows."
      : "The object reaches beyond the picture. Drag the white square to scale it, or the arrows to move it; or move the view and press Set camera.");
  }

  return { draw, greet };
}
