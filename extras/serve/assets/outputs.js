// Which output is shown, where it is along the axes, and what it is compared with.
import { $, clock, el, show } from "./dom.js";
import { shows } from "./graph.js";
import { json } from "./server.js";

// The part of the name of a node after the name in the file: its place along the axes.
const along = (id) => id.slice(id.indexOf("/") + 1 || id.length);

// `page` gives the graph (`view`) and the state (`state`); `picture` is the pane of the picture.
export function Outputs(page, picture) {
  let output = null;
  // True if the user has chosen the output; else it is the picture that the graph makes.
  let own = false;

  // The outputs that can be shown, with their digests.
  function values() {
    const found = {};
    for (const node of page.view.nodes ?? []) {
      for (const out of page.state.nodes[node.id]?.outputs ?? []) if (shows(out)) found[`${node.id}.${out.port}`] = out.digest;
    }
    return found;
  }

  // The output that a sink writes, else the last one.
  function favourite(found) {
    for (const target of page.view.targets ?? []) {
      const index = page.view.nodes.findIndex((node) => node.id === target);
      const wire = page.view.wires.find(([, , below]) => below === index);
      const name = wire && `${page.view.nodes[wire[0]].id}.${wire[1]}`;
      if (name && found[name]) return name;
    }
    return Object.keys(found).at(-1) ?? null;
  }

  const nodeOf = (name) => page.view.nodes?.find((one) => name?.startsWith(`${one.id}.`) && !name.slice(one.id.length + 1).includes("."));

  // The outputs of the instances along axes of the node whose output is shown.
  function siblings() {
    const node = nodeOf(output);
    if (!node || !along(node.id)) return [];
    const port = output.slice(node.id.length);
    return page.view.nodes.filter((one) => one.in_file === node.in_file).map((one) => one.id + port);
  }

  const here = () => along(output?.slice(0, output.lastIndexOf(".")) ?? "");

  // One slider for each axis along which the output has more than one place.
  let scrubbed = "";
  function axes() {
    const parts = (name) => along(name.slice(0, name.lastIndexOf("."))).split("/").map((part) => [part.slice(0, part.indexOf("=")), part.slice(part.indexOf("=") + 1)]);
    const all = siblings().map(parts);
    const shown = all.length > 1 ? parts(output) : [];
    const found = shown.map(([axis, place], index) => ({ axis, place, places: [...new Set(all.map((one) => one[index]?.[1]))] })).filter(({ places }) => places.length > 1);
    const signature = JSON.stringify(found.map(({ axis, places }) => [axis, places]));
    if (signature !== scrubbed) {
      scrubbed = signature;
      show($("axes"), found.map(({ axis, places }, index) => {
        const slider = el("input", { id: index ? `axis-${index + 1}` : "axis", type: "range", min: 0, max: places.length - 1, step: 1, "aria-label": `Place along ${axis}`, oninput: () => page.go(axis, places[Number(slider.value)]) });
        return el("label", {}, slider, " ", el("output", {}));
      }));
    }
    found.forEach(({ axis, place, places }, index) => {
      const label = $("axes").children[index];
      label.querySelector("input").value = places.indexOf(place);
      label.querySelector("output").value = `${axis}=${place}`;
    });
  }

  let shown = "";
  function update() {
    const found = values();
    if (!own || !output || (!found[output] && !page.state.running)) [output, own] = [favourite(found), own && Boolean(found[output])];
    axes();
    written();
    const names = Object.keys(found);
    const signature = JSON.stringify([names, output]);
    if (signature !== shown) {
      shown = signature;
      show($("output"), names.map((name) => el("option", { value: name, selected: name === output }, name)));
    }
    others();
    draw();
  }

  // The file to which the picture is written.
  function written() {
    const from = ([index, port]) => `${page.view.nodes[index].id}.${port}`;
    const sinks = (page.view.wires ?? []).filter((wire) => from(wire) === output).map(([, , below]) => page.view.nodes[below].id);
    const [path, file] = Object.entries(page.state.files).find(([, one]) => sinks.includes(one.id)) ?? [];
    $("written").textContent = path ? `File: ${path}${file.preview ? " (a preview)" : ""}` : "";
  }

  function choose(name) {
    [output, own] = [name, true];
    update();
  }

  function draw() {
    const found = values();
    const layer = Number($("layer").value || 0);
    if (output && found[output]) picture.load("a", found[output], layer);
    const [kind, which] = ($("other").value || "").split("|");
    const shot = kind === "shot" ? page.state.history.shots.find((one) => String(one.seconds) + one.text === which) : null;
    const file = kind === "file" ? files.find((one) => one.id === which) : null;
    const graph = kind === "graph" ? graphs.find((one) => one.value === which) : null;
    const digest = kind === "output" ? found[which] : graph ? graph.digest : shot?.values[output]?.[1] ?? file?.id;
    picture.load("b", digest ?? null, file || graph ? 0 : layer);
    $("label-a").textContent = `A: ${output ?? ""}`;
    $("label-b").textContent = shot ? `B: ${shot.label}, ${clock(shot.seconds)}` : `B: ${file?.name ?? graph?.label ?? which ?? ""}`;
  }

  let layersShown = "";
  function layers(about) {
    const names = about.pictures.map((one) => one.name || "picture");
    $("layer-label").hidden = names.length < 2;
    const signature = JSON.stringify([output, names]);
    if (signature === layersShown) return;
    layersShown = signature;
    const kept = Math.min(Number($("layer").value || 0), Math.max(0, names.length - 1));
    show($("layer"), names.map((name, index) => el("option", { value: index, selected: index === kept }, name)));
  }

  // Picture files near the graph, asked for when the pointer comes to the menu.
  let files = [];
  async function look() {
    try {
      const list = await json("/references");
      if (JSON.stringify(list) === JSON.stringify(files)) return;
      files = list;
      others();
    } catch { /* the menu then has the files that were known */ }
  }

  // Pictures of other graphs near the graph, which takes longer: asked for when the user comes to the menu.
  let graphs = [];
  let asked = 0;
  async function lookFar() {
    look();
    if (Date.now() - asked < 2000) return;
    asked = Date.now();
    try {
      const list = await json("/graphs");
      const next = list.flatMap(({ name, pictures }) => pictures.map(([output, digest]) => ({ value: `${name} ${output}`, label: `${name}: ${output}`, digest })));
      if (JSON.stringify(next) === JSON.stringify(graphs)) return;
      graphs = next;
      others();
      draw();
    } catch { /* the menu then has the graphs that were known */ }
  }

  let othersShown = "";
  function others() {
    const shots = page.state.history.shots.filter((shot) => shot.values[output]).toReversed();
    const names = Object.keys(values()).filter((name) => name !== output);
    const signature = JSON.stringify([shots.map((shot) => shot.seconds), names, files, graphs]);
    if (signature === othersShown) return;
    othersShown = signature;
    const kept = $("other").value;
    const option = (value, label) => el("option", { value, selected: value === kept }, label);
    const group = (label, options) => (options.length ? el("optgroup", { label }, options) : null);
    show($("other"), option("", "nothing"),
      group("History", shots.map((shot) => option(`shot|${shot.seconds}${shot.text}`, `${clock(shot.seconds)} ${shot.label}`))),
      group("Files", files.map((one) => option(`file|${one.id}`, one.name))),
      group("Graphs", graphs.map((one) => option(`graph|${one.value}`, one.label))),
      group("Other outputs", names.map((name) => option(`output|${name}`, name))));
  }

  // The name of a node at another place along an axis.
  const moved = (id, axis, place) => id.split("/").map((part) => (part.startsWith(`${axis}=`) ? `${axis}=${place}` : part)).join("/");

  // Shows the output at another place along an axis.
  function move(axis, place) {
    const port = output.lastIndexOf(".");
    const next = moved(output.slice(0, port), axis, place) + output.slice(port);
    if (values()[next]) choose(next);
  }

  // Compares the picture with an earlier result.
  function against(shot) {
    if (!shot.values[output]) return;
    others();
    $("other").value = `shot|${shot.seconds}${shot.text}`;
    if (picture.mode() === 0) picture.set(1);
    draw();
  }

  // The picture that the graph makes at the place along axes that is shown, with its size, for the place view.
  let made = null;
  let asking = null;
  async function pick(changed) {
    const found = values();
    const name = favourite(found) ?? "";
    const port = name.lastIndexOf(".");
    const digest = found[`${name.slice(0, port).split("/")[0]}/${here()}${name.slice(port)}`] ?? found[name];
    if (!digest || asking === digest || (!asking && made?.digest === digest)) return;
    asking = digest;
    try {
      const one = (await json(`/value/${digest}`)).pictures[0];
      // Of several answers, the last one counts, in whatever order they come.
      if (asking !== digest) return;
      made = one ? { digest, number: 0, width: one.width, height: one.height } : null;
      changed();
    } catch { /* the next result comes */ }
    if (asking === digest) asking = null;
  }

  $("output").addEventListener("change", () => choose($("output").value));
  $("layer").addEventListener("change", draw);
  for (const come of ["pointerenter", "focus"]) $("other").addEventListener(come, lookFar);
  $("other").addEventListener("change", () => { if (picture.mode() === 0) picture.set(1); draw(); });

  return {
    update, written, choose, draw, layers, others, siblings, values, here, move, moved, pick, against, look, nodeOf,
    favourite: () => favourite(values()), output: () => output, made: () => made,
  };
}
