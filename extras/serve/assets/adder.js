// The panel that adds an object to a graph.
import { $, el, fileLabel, number, show } from "./dom.js";
import { json } from "./server.js";

// An object of more metres than this is probably in centimetres.
const LARGE = 20;

export function Adder(stage, things, pointer) {
  const { page, note } = stage;

  async function open() {
    if (!$("add").hidden) return close();
    let names = [];
    try { names = await json("/objects"); } catch (error) { return page.notify(error.message); }
    const list = el("select", { id: "add-object", "aria-label": "Object" }, names.map((name) => el("option", { value: name }, fileLabel(name))));
    show($("add"), el("h3", {}, "Add an object"),
      names.length ? el("p", { class: "tool" }, list, el("button", { id: "add-click", type: "button", onclick: () => stand(list.value) }, "Click the floor"))
        : el("p", {}, "There is no .glb or .gltf file in the folder of the graph. Copy one there."),
      el("p", { class: "dim" }, "This writes LoadObject, Pose and Place into the text, and a wire into `objects` of PathTrace. Undo takes all of it back."),
      el("p", {}, el("button", { type: "button", onclick: close }, "Close")));
    $("add").hidden = false;
    return $("add").querySelector("select, button").focus();
  }

  function close() {
    $("add").hidden = true;
    $("space").focus({ preventScroll: true });
  }

  function stand(object) {
    if (stage.tool) return pointer.wait(null);
    return pointer.wait((p) => things.ground.ask([stage.view.eye, stage.view.ray(...p)], (found) => things.ground.stands(found) && add(object, found.position)));
  }

  async function add(object, place) {
    pointer.wait(null);
    note("Adding the object ..");
    const answer = await page.add({ object, place });
    note("");
    if (answer === null) return;
    close();
    stage.wanted = answer.pose;
    if (answer.metres > LARGE) note(`The file says that the object has a size of ${number(answer.metres)} m. If it is in centimetres, set the scale of \`${answer.pose}\` to 0.01.`);
    page.choose(answer.pose);
    stage.load();
  }

  // The button is there if the graph shows objects.
  function draw() {
    const traces = page.graph().nodes?.some((one) => one.kind === "PathTrace" && one.span);
    $("place-add").hidden = !traces || page.graph().confined;
    if ($("place-add").hidden) $("add").hidden = true;
  }

  $("place-add").addEventListener("click", open);
  return { draw };
}
