// The panel that puts an object into a bare capture.
import { $, el, show } from "./dom.js";
import { add, dot, mul, sub } from "./space.js";

export function Starter(stage, things, pointer) {
  const { page, note } = stage;
  let shown = "";

  function draw() {
    const { start } = stage.scene;
    const signature = JSON.stringify(start);
    if (signature === shown) return;
    shown = signature;
    $("start").hidden = !start;
    if (!start) return;
    const { proposals, objects } = start;
    const list = el("select", { id: "start-object", "aria-label": "Object" }, objects.map((name) => el("option", { value: name }, name)));
    show($("start"), el("h3", {}, "Put an object into the place"),
      objects.length ? el("p", {}, list, " ", el("button", { id: "start-click", type: "button", onclick: stand }, "Click the floor"))
        : el("p", {}, "There is no .glb or .gltf file in the folder of the graph or of the capture. Copy one there, and open this page again."),
      el("p", { class: "dim" }, "The camera of the picture will be where you look from."),
      el("dl", {}, proposals.map(({ what, value }) => [el("dt", {}, what), el("dd", {}, value)]).flat()));
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
    await page.start({ object, stand: { place: found.position, eye: rounded(view.eye), target: rounded(target), fov_y_deg: Number(fov.toFixed(2)) } });
    note("");
    stage.spot = null;
    stage.follow = view.camera;
    stage.load();
  }

  return { draw };
}
