// Questions about the ground under the pointer and under objects. One question is on its way at a time, and the last
// one wins.
import { post } from "./server.js";
import { add, dot, mul, sub } from "./space.js";

// Ground that is steeper than this is not stood on, as for `Pose(pixel: ..)`.
const STEEP_DEG = 45;

export function Ground(stage, corners) {
  let asking = null;

  // Calls `answer` with the first surface along a ray, or with the reason why there is none.
  function ask(ray, answer) {
    const next = { ray, answer };
    if (asking) { asking.next = next; return; }
    asking = next;
    (async () => {
      while (asking) {
        const { ray: [eye, way], answer: give } = asking;
        let found;
        try { found = await post("/ground", { digest: stage.ground(), eye, way, focal_px: stage.view.lens().fy }); } catch (error) { found = { position: null, why: error.message }; }
        asking = asking.next ?? null;
        give(found);
      }
    })();
  }

  // The ground below an object that was moved by `way`.
  function below(start, way, answer) {
    const { up } = stage.scene;
    const [low, high] = corners(start.one, start.matrix);
    const over = Math.max(0.25 * Math.abs(dot(sub(high, low), up)), 0.05 * stage.metre());
    ask([add(add(start.foot, way), mul(up, over)), mul(up, -1)], answer);
  }

  // True if an object can stand on what was found; else the reason is shown.
  function stands(found) {
    if (!found.position) { stage.note(found.why); return false; }
    if (found.steep_deg > STEEP_DEG) { stage.note(`The surface there is ${Math.round(found.steep_deg)} degrees steep, too steep to stand on.`); return false; }
    stage.note("");
    return true;
  }

  return { ask, below, stands, waits: () => Boolean(asking) };
}
