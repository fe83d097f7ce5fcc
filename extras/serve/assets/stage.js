// The data of the place view: the captured place, the objects, the cameras, and what is selected among them.
import { $, el, show } from "./dom.js";
import { bytes, json } from "./server.js";
import { distance, dot, unpacked, View } from "./space.js";

// `page` is the page as `Place` has it, `solid` draws, and `redraw` asks for a frame. `arrived` is called with each
// description of the place, before its splats and meshes are there, and `settled` when they are.
export function Stage({ page, solid, redraw, arrived, settled }) {
  const stage = {
    page,
    solid,
    redraw,
    scene: null,
    view: null,
    // Size of the captured place: the median distance of the splats from their middle.
    radius: 1,
    // Lowest and highest splats, without outliers.
    heights: [0, 1],
    selected: 0,
    // The object while it is moved: its matrix, until the results of the edit are there.
    override: null,
    // Points whose distance is measured.
    ruler: [],
    // A point of the ground that is marked.
    spot: null,
    // A drag, and a tool that waits for a click.
    drag: null,
    tool: null,
    // True when the first view has been chosen, or the user has moved it.
    looked: false,
    // The name of a pose that was added, until its object is there.
    wanted: null,
    // The point of the pane that keys have chosen while a tool waits for a click.
    aim: null,
    // The camera that was set, until its new value is there.
    follow: null,
    load,
    menus,
    splats,
    shape,
    metre: () => 1 / stage.scene.metres_per_unit,
    object: () => stage.scene?.objects[stage.selected],
    matrix: (one) => (stage.override?.node === one.node ? stage.override.matrix : one.matrix),
    bounds: (one) => solid.bounds(one.shape),
    note: (words) => { $("space-note").textContent = words ?? ""; },
    mesh: () => stage.scene.meshes.find((one) => one.receiver) ?? stage.scene.meshes[0],
    // The value that rays of the pointer hit: the mesh that receives shadows, else the splats.
    ground: () => stage.mesh()?.digest ?? stage.scene.splats[0]?.digest,
    // Height above which splats are hidden.
    cut: () => {
      const share = Number($("place-cut").value);
      const [low, high] = stage.heights;
      return share >= 1 ? Infinity : low + share * (high - low);
    },
    // Digits behind the point of a coordinate that is written: a tenth of a millimetre.
    decimals: () => Math.max(0, Math.min(12, 4 + Math.ceil(Math.log10(stage.scene.metres_per_unit) - 1e-9))),
  };

  let loading = null;
  // The description of the place that was taken last.
  let taken = "";
  async function load() {
    if (loading) { loading.again = true; return; }
    loading = {};
    try {
      const next = await json("/place");
      // Many events of a run change nothing here; a frame of the place costs more than a comparison.
      const signature = JSON.stringify([next, page.along()]);
      if (next && (signature !== taken || stage.override || stage.follow)) {
        taken = signature;
        await take(next);
      } else if (next) arrived();
      missing();
    } catch (error) {
      taken = "";
      page.notify(error.message);
    }
    const { again } = loading;
    loading = null;
    if (again) await load();
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
    const before = stage.scene;
    const chosen = stage.object()?.node;
    stage.scene = next;
    stage.view ??= new View(next);
    if (before && before.name !== next.name) stage.view.frame = next;
    const { override } = stage;
    const known = override && next.objects.find((one) => one.node === override.node);
    if (!stage.drag && override && (!known || override.done && String(known.matrix) !== String(override.before))) stage.override = null;
    // The same object stays selected, also if others came or went.
    const again = next.objects.findIndex((one) => one.node === chosen);
    stage.selected = Math.max(0, again < 0 ? Math.min(stage.selected, next.objects.length - 1) : again);
    const fresh = next.objects.findIndex((one) => one.pose && one.pose === stage.wanted);
    if (fresh >= 0) [stage.selected, stage.wanted] = [fresh, null];
    menus();
    arrived();
    if (!before) await splats();
    for (const one of next.objects) await shape(one.shape, `/object/${one.shape}`);
    if ($("place-mesh").checked && stage.mesh()) await shape(stage.mesh().digest, `/mesh/${stage.mesh().digest}`);
    if (before) await splats();
    tidy();
    settled();
    redraw();
  }

  function missing() {
    const { scene } = stage;
    if (!scene) return;
    const node = page.graph().nodes?.find((one) => one.kind === "Place" && !page.state().nodes[one.id]?.outputs.length);
    if (!scene.splats.length) stage.note("The graph has no splats yet.");
    else if (node) stage.note(`\`${node.id}\` has no result yet, so its object is not shown.`);
    else if ($("space-note").textContent.includes("yet")) stage.note("");
  }

  const shapes = new Map();
  async function shape(name, path) {
    if (!shapes.has(name)) {
      shapes.set(name, bytes(path).then((buffer) => { solid.mesh(name, unpacked(buffer)); redraw(); }).catch((error) => { shapes.delete(name); page.notify(error.message); }));
    }
    await shapes.get(name);
  }

  // Frees the shapes that nothing uses any more.
  function tidy() {
    const used = [...stage.scene.objects.map((one) => one.shape), ...stage.scene.meshes.map((one) => one.digest)];
    for (const name of shapes.keys()) if (!used.includes(name)) { shapes.delete(name); solid.remove(name); }
  }

  let shownSplats = null;
  async function splats() {
    const { scene } = stage;
    const chosen = scene.splats[Number($("place-splats").value || 0)] ?? scene.splats[0];
    if (!chosen || shownSplats === chosen.digest) return;
    shownSplats = chosen.digest;
    const cloud = solid.splats(unpacked(await bytes(`/splats/${chosen.digest}`)));
    const [away, tall] = [[], []];
    for (let i = 0; i < cloud.count; i += Math.max(1, cloud.count >> 12)) {
      const at = [0, 1, 2].map((k) => cloud.floats[8 * i + k]);
      away.push(distance(at, [0, 0, 0]));
      tall.push(dot(at.map((v, k) => v + cloud.origin[k]), scene.up));
    }
    for (const list of [away, tall]) list.sort((a, b) => a - b);
    stage.radius = away[away.length >> 1] || 1;
    stage.heights = [tall[Math.floor(tall.length * 0.02)] ?? 0, tall[Math.floor(tall.length * 0.98)] ?? 1];
    const count = (n) => n.toLocaleString("en");
    $("splat-count").textContent = cloud.count < cloud.total ? `${count(cloud.count)} of ${count(cloud.total)} splats` : `${count(cloud.count)} splats`;
  }

  const shownMenus = {};
  function menu(id, options, chosen) {
    const signature = JSON.stringify([options, chosen]);
    if (shownMenus[id] === signature) return;
    shownMenus[id] = signature;
    show($(id), options.map(([value, label]) => el("option", { value, selected: String(value) === String(chosen) }, label)));
  }

  function menus() {
    const { scene, view, selected } = stage;
    const at = view?.camera ? scene.cameras.findIndex((one) => one.id === view.camera.id && one.name === view.camera.name) : -1;
    menu("place-view", [["", "free"], ...scene.cameras.map((one, index) => [index, one.name === one.node ? one.node : `${one.id}: ${one.name}`])], at < 0 ? "" : at);
    menu("place-splats", scene.splats.map((one, index) => [index, one.node]), $("place-splats").value || 0);
    menu("place-object", scene.objects.map((one, index) => [index, one.node]), selected);
    $("place-splats-label").hidden = scene.splats.length < 2;
    $("place-object-label").hidden = scene.objects.length < 2;
    $("place-mesh").disabled = !stage.mesh();
    for (const id of ["place-click", "place-drop"]) $(id).disabled = !stage.object();
  }

  return stage;
}
