// Measuring in the place view: the distance between two points that are clicked, and the scale of the place from it.
import { $, number } from "./dom.js";
import { scaleText } from "./fields.js";
import { distance } from "./space.js";

export function Measure(stage, things, pointer) {
  const { page, note } = stage;
  let points = [];

  // Waits for two clicks.
  function begin() {
    if (stage.tool) return pointer.wait(null);
    points = [];
    stage.ruler = points;
    panel();
    pointer.wait(click, "Click the first of two points whose distance you know, or aim with the arrow keys and press Enter. Escape: leave.");
    $("place-measure").setAttribute("aria-pressed", "true");
    return stage.redraw();
  }

  function click(p) {
    things.ground.ask([stage.view.eye, stage.view.ray(...p)], (found) => {
      if (!found.position) return note(found.why);
      points.push(found.position);
      if (points.length === 2) pointer.wait(null);
      note(points.length === 1 ? "Click the second point." : "");
      panel();
      return stage.redraw();
    });
  }

  const units = () => distance(points[0], points[1]);

  function panel() {
    const ready = points.length === 2;
    $("ruler").hidden = !ready;
    if (!ready) return;
    $("ruler-length").value = String(Number((units() * stage.scene.metres_per_unit).toPrecision(4)));
    $("ruler-units").textContent = `${number(units())} world units, now`;
  }

  // Writes the scale at which the distance has the length that the user has typed.
  async function set() {
    const metres = Number($("ruler-length").value.replace(",", "."));
    if (!(metres > 0) || !Number.isFinite(metres)) return note("The length must be a number of metres above 0.");
    const good = await page.set({ node: "scene", field: "metres_per_unit", at: [], value: scaleText(metres / units()) });
    if (good !== null) close();
    return null;
  }

  function close() {
    points = [];
    stage.ruler = points;
    panel();
    stage.redraw();
  }

  $("place-measure").addEventListener("click", begin);
  $("ruler").addEventListener("submit", (event) => { event.preventDefault(); set(); });
  $("ruler-close").addEventListener("click", close);
  return { begin, leave: () => { if (points.length < 2) close(); } };
}
