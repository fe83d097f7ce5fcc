// The page: follows the events of the watch, and connects the panes.
import { $, clock, el, seconds, show } from "./dom.js";
import { enter, json, listen, post } from "./server.js";
import { Graph, shows } from "./graph.js";
import { Text } from "./text.js";
import { field, flowing } from "./fields.js";
import { Picture } from "./picture.js";

let state = { nodes: {}, mistakes: [], files: {}, warnings: [], history: { shots: [] } };
let view = { digest: null, mistakes: [] };
let chosen = null;
let output = null;
let connected = false;

const graph = Graph(choose);
const text = Text();
const picture = Picture((side, about, error) => {
  if (error) return side === "a" ? notify(error.message) : notify(`B: ${error.message}`);
  if (side === "a") { layers(about); picture.tables(about.report); }
});
// The place view; its code is loaded when it is opened for the first time.
let place = null;

// Digest of the text that an edit of the page has written, until the page has fetched the graph of this text.
let written = null;

// Sends a request that edits the text, after the ones before it. An edit is made of the text that the page shows when
// the user makes it, or of the text that the edit before it wrote.
let edits = Promise.resolve();
let queued = 0;
function change(path, data) {
  const seen = queued ? null : written ?? view.digest;
  queued += 1;
  const sent = edits.then(() => send(path, data, seen)).finally(() => { queued -= 1; });
  edits = sent.catch(() => {});
  return sent;
}

async function send(path, data, seen) {
  try {
    written = (await post(path, { ...data, digest: seen ?? written ?? view.digest })).digest;
    notify(null);
  } catch (error) {
    if (error.body?.code === "stale") { written = null; refresh(); }
    throw error;
  }
}

// ---- notices

function notify(message) {
  $("notice").hidden = !message;
  show($("notice"), el("span", {}, message ?? ""), el("span", { class: "space" }), el("button", { type: "button", onclick: () => notify(null) }, "Close"));
}

async function attempt(action) {
  try { return await action(); } catch (error) { notify(error.message); return null; }
}

function status() {
  const { pass, plan, done, running } = state;
  const failed = state.mistakes.length + (state.problem ? 1 : 0);
  const line = !connected ? "not connected; waiting for `lightharmony watch --serve`"
    : failed ? `${state.problem ?? `${state.mistakes.length} mistake${state.mistakes.length > 1 ? "s" : ""}`}; the last good result is shown`
    : running ? [pass ? `preview: ${pass.level} of ${pass.of} ${pass.parameter}${pass.coarse > 1 ? `, blocks of ${pass.coarse} px` : ""}` : "running",
      plan?.open ? `${plan.open} nodes, about ${seconds(plan.seconds)}` : ""].filter(Boolean).join("; ")
    : done ? `up to date; ${done.ran} ran, ${done.cached} cached, ${seconds(done.seconds)}, at ${clock(done.at)}` : "up to date";
  $("status").textContent = line + (state.history.tried?.length ? "; trying a value" : "");
  $("status").className = failed || !connected ? "failed" : running ? "running" : "";
}

// ---- the graph

let fetching = null;
async function refresh() {
  // One request at a time; one more if the graph changed meanwhile.
  if (fetching) { fetching.again = true; return; }
  fetching = {};
  await attempt(async () => {
    view = await json("/graph");
    if (view.digest === written) written = null;
    document.title = `${view.name?.split("/").pop() ?? "graph"} · lightharmony`;
    $("name").textContent = view.name ?? "lightharmony";
    if (!view.nodes?.some((node) => node.id === chosen)) chosen = view.nodes?.find((node) => node.kind === "Pose")?.id ?? view.nodes?.[0]?.id ?? null;
    graph.draw(view, state.nodes);
    graph.mark(chosen);
    outputs();
    nodePane();
    texts();
    place?.changed();
    begin();
  });
  const { again } = fetching;
  fetching = null;
  if (again) await refresh();
}

let mistakesShown = "";
function texts() {
  const node = view.nodes?.find((one) => one.id === chosen);
  if (!$("text").hidden) text.draw(view, node?.line);
  const own = view.mistakes ?? [];
  status();
  // An unchanged list is not replaced, so that a button in it keeps the focus.
  const signature = JSON.stringify([view.problem, own]);
  if (signature === mistakesShown) return;
  mistakesShown = signature;
  show($("mistakes"), view.problem && el("p", { class: "error" }, view.problem), own.map((one) => el("p", { class: "error" },
    el("button", { type: "button", onclick: () => { tab(true); text.scroll(one.line); } }, `line ${one.line}`), " ",
    [one.message, one.label, ...(one.hints ?? [])].filter(Boolean).join("\n"))));
}

function tab(toText) {
  $("text").hidden = !toText;
  $("graph").hidden = toText;
  $("tab-text").setAttribute("aria-pressed", String(toText));
  $("tab-graph").setAttribute("aria-pressed", String(!toText));
  texts();
}

function choose(id) {
  chosen = id;
  graph.mark(id);
  nodePane();
  texts();
  const line = view.nodes.find((node) => node.id === id)?.line;
  if (!$("text").hidden && line) text.scroll(line);
  const first = (state.nodes[id]?.outputs ?? []).find(shows);
  if (first) { output = `${id}.${first.port}`; outputs(); }
}

// ---- the pane of a node

let waiting = null;
let trying = null;
// True from the first trial of a value until it is written or dropped.
let dragging = false;

// Writes an edit; gives null if it was refused.
const set = (edit) => attempt(async () => {
  // A trial or a plan that is still on its way must not come after the edit.
  [trying, dragging] = [null, false];
  clearTimeout(waiting);
  waiting = null;
  await change("/set", edit);
  graph.would([]);
  return true;
}).then((done) => {
  if (done === null) { post("/try", null).catch(() => {}); nodePane(true); }
  return done;
});

// Tries an edit. At most one trial is on its way, and the last one wins.
function tryOut(edit) {
  const busy = trying !== null;
  [trying, dragging] = [{ digest: written ?? view.digest, ...edit }, true];
  if (!busy) run();
}

function revert() {
  [trying, dragging] = [null, false];
  graph.would([]);
  attempt(() => post("/try", null));
}

function editOf(node, param) {
  const whole = (value, at) => ({ digest: written ?? view.digest, node: node.in_file, field: param.name, at, value });
  return {
    set: (value, at) => set(whole(value, at)),
    attempt: (value, at) => tryOut(whole(value, at)),
    revert,
    plan: (value, at) => {
      clearTimeout(waiting);
      const own = setTimeout(async () => {
        try {
          const { nodes, forecast } = await post("/plan", whole(value, at));
          if (waiting !== own) return;
          graph.would(nodes);
          $("plan").textContent = nodes.length ? `would run ${nodes.join(", ")}${forecast.seconds ? `; about ${seconds(forecast.seconds)}` : ""}` : "would run nothing";
        } catch (error) {
          if (waiting !== own) return;
          graph.would([]);
          $("plan").textContent = error.message;
        }
      }, 200);
      waiting = own;
    },
  };
}

async function run() {
  while (trying) {
    const next = trying;
    try { await post("/try", next); } catch (error) { notify(error.message); trying = null; return; }
    if (trying === next) { trying = null; return; }
  }
}

let paneShown = "";
function nodePane(force = false) {
  const node = view.nodes?.find((one) => one.id === chosen);
  if (!node) return show($("node"), el("p", { class: "dim" }, "No node is chosen."));
  const kind = view.kinds[node.kind];
  const now = state.nodes[node.id] ?? {};
  const signature = JSON.stringify([node.id, node.values, view.confined]);
  // A slider is not replaced while it is dragged.
  if (!force && (signature === paneShown || dragging)) return facts(node, now);
  paneShown = signature;
  const focus = document.activeElement?.closest?.("#node") ? document.activeElement.getAttribute("aria-label") : null;
  const fixed = view.confined ? "This graph belongs to an unpacked bundle, whose files are never written."
    : node.span === null ? "Another file defines this node; edit it there." : null;
  show($("node"), el("h2", {}, `${node.id}: ${node.kind}`), el("div", { id: "facts" }), el("div", { class: "dim", id: "plan", role: "status" }),
    kind.params.map((param) => field(param, node.values[param.name] ?? { value: param.default, text: null }, editOf(node, param), fixed)),
    el("details", { class: "doc" }, el("summary", {}, "About this kind"), el("p", {}, flowing(kind.doc))));
  if (focus) $("node").querySelector(`[aria-label="${CSS.escape(focus)}"]`)?.focus();
  facts(node, now);
}

function facts(node, now) {
  const time = now.status === "running" ? `running, ${Math.round(now.fraction * 100)} %${now.forecast ? ` of about ${seconds(now.forecast)}` : ""}`
    : `${now.status ?? "unknown"}${now.seconds ? `, ${seconds(now.seconds)} (${seconds(now.cpu_seconds)} of CPU time)` : ""}${now.preview ? ", preview" : ""}`;
  const place = $("facts");
  if (!place) return;
  show(place, el("p", { class: "dim" }, `${time}${node.line ? `; line ${node.line}` : ""}`), now.error && el("p", { class: "error" }, now.error),
    now.notes?.length ? el("ul", { class: "list" }, now.notes.map((note) => el("li", { class: `note ${note.level}` }, note.text))) : null,
    now.outputs?.length ? el("div", {}, now.outputs.map((out) => el("button", {
      type: "button", disabled: !shows(out), title: shows(out) ? "Show it" : "Values of this type are not pictures", onclick: () => { output = `${node.id}.${out.port}`; outputs(); },
    }, `${out.port} (${out.type})`))) : null);
}

// ---- outputs, layers, and what they are compared with

function values() {
  const found = {};
  for (const node of view.nodes ?? []) {
    for (const out of state.nodes[node.id]?.outputs ?? []) if (shows(out)) found[`${node.id}.${out.port}`] = out.digest;
  }
  return found;
}

// The output that a sink writes, else the last one.
function favourite(found) {
  for (const target of view.targets ?? []) {
    const index = view.nodes.findIndex((node) => node.id === target);
    const wire = view.wires.find(([, , below]) => below === index);
    const name = wire && `${view.nodes[wire[0]].id}.${wire[1]}`;
    if (name && found[name]) return name;
  }
  return Object.keys(found).at(-1) ?? null;
}

// The part of the name of a node after the name in the file: its place along the axes.
const along = (id) => id.slice(id.indexOf("/") + 1 || id.length);

// The outputs of the instances along axes of the node whose output is shown.
function siblings() {
  const node = view.nodes?.find((one) => output?.startsWith(`${one.id}.`));
  if (!node || !along(node.id)) return [];
  const port = output.slice(node.id.length);
  return view.nodes.filter((one) => one.in_file === node.in_file).map((one) => one.id + port);
}

function axes() {
  const all = siblings();
  $("axis-label").hidden = all.length < 2;
  if (all.length < 2) return;
  $("axis").max = all.length - 1;
  $("axis").value = all.indexOf(output);
  const port = output.lastIndexOf(".");
  $("axis-value").textContent = along(output.slice(0, port));
}

let outputsShown = "";
function outputs() {
  const found = values();
  if (!output || (!found[output] && !running())) output = favourite(found);
  axes();
  const names = Object.keys(found);
  const signature = JSON.stringify([names, output]);
  if (signature !== outputsShown) {
    outputsShown = signature;
    show($("output"), names.map((name) => el("option", { value: name, selected: name === output }, name)));
  }
  others();
  draw();
}

const running = () => state.running;

function draw() {
  const found = values();
  if (output && found[output]) picture.load("a", found[output], Number($("layer").value || 0));
  const [kind, which] = ($("other").value || "").split("|");
  const shot = kind === "shot" ? state.history.shots.find((one) => String(one.seconds) + one.text === which) : null;
  const digest = kind === "output" ? found[which] : shot?.values[output]?.[1];
  picture.load("b", digest ?? null, Number($("layer").value || 0));
  $("label-a").textContent = `A: ${output ?? ""}`;
  $("label-b").textContent = shot ? `B: ${shot.label}, ${clock(shot.seconds)}` : `B: ${which ?? ""}`;
}

let layersShown = "";
function layers(about) {
  const names = about.pictures.map((one) => one.name || "picture");
  const signature = JSON.stringify([output, names]);
  if (signature === layersShown) return;
  layersShown = signature;
  const kept = Math.min(Number($("layer").value || 0), Math.max(0, names.length - 1));
  show($("layer"), names.map((name, index) => el("option", { value: index, selected: index === kept }, name)));
}

let othersShown = "";
function others() {
  const shots = state.history.shots.filter((shot) => shot.values[output]).toReversed();
  const names = Object.keys(values()).filter((name) => name !== output);
  const signature = JSON.stringify([shots.map((shot) => shot.seconds), names]);
  if (signature === othersShown) return;
  othersShown = signature;
  const kept = $("other").value;
  const option = (value, label) => el("option", { value, selected: value === kept }, label);
  show($("other"), option("", "nothing"),
    el("optgroup", { label: "History" }, shots.map((shot) => option(`shot|${shot.seconds}${shot.text}`, `${clock(shot.seconds)} ${shot.label}`))),
    el("optgroup", { label: "Other outputs" }, names.map((name) => option(`output|${name}`, name))));
}

// ---- the place view

// The picture that the graph makes, with its size, for the place view.
let made = null;
async function picked() {
  const found = values();
  // The instance along axes that is shown, of the output that the graph writes.
  const name = favourite(found) ?? "";
  const port = name.lastIndexOf(".");
  const here = `${name.slice(0, port).split("/")[0]}/${along(output?.slice(0, output.lastIndexOf(".")) ?? "")}${name.slice(port)}`;
  const digest = found[here] ?? found[name];
  if (!digest || made?.digest === digest) return;
  try {
    const about = await json(`/value/${digest}`);
    const one = about.pictures[0];
    made = one ? { digest, number: 0, width: one.width, height: one.height } : null;
    place?.redraw();
  } catch { /* the next result comes */ }
}

// A bare capture is shown as a place at once.
let begun = false;
async function begin() {
  if (begun) return;
  begun = true;
  if (view.nodes && !view.nodes.some((node) => node.kind === "PathTrace") && view.starts) await pane(true);
}

// Puts an object into a bare capture; the new graph then shows its pose.
const start = (data) => attempt(async () => {
  await change("/start", data);
  chosen = null;
});

async function pane(toPlace) {
  $("picture").hidden = toPlace;
  $("place").hidden = !toPlace;
  $("tab-place").setAttribute("aria-pressed", String(toPlace));
  $("tab-picture").setAttribute("aria-pressed", String(!toPlace));
  if (!toPlace) return picture.redraw();
  return attempt(async () => {
    const { Place } = await import("/assets/place.js");
    place ??= Place({ graph: () => view, state: () => state, picture: () => made, along: () => along(output?.slice(0, output.lastIndexOf(".")) ?? ""), set, attempt: tryOut, revert, choose, notify, start });
    place.open();
    await picked();
  });
}

// ---- history

function historyPane() {
  const { undo = 0, redo = 0, last, next, problem, shots = [] } = state.history;
  $("undo").disabled = !undo;
  $("redo").disabled = !redo;
  $("undo").title = undo ? `Undo: ${last} (Ctrl+Z)` : "Nothing to undo";
  $("redo").title = redo ? `Redo: ${next} (Ctrl+Shift+Z)` : "Nothing to redo";
  show($("history"), el("h3", {}, "History"), problem && el("p", { class: "warning" }, problem),
    state.warnings.map((warning) => el("p", { class: "warning" }, warning)),
    el("p", { class: "dim" }, `${undo} changes can be undone, ${redo} redone.`),
    el("ul", { class: "list" }, shots.slice(-12).toReversed().map((shot) => el("li", {}, `${clock(shot.seconds)} ${shot.label}`))));
  others();
  status();
}

const step = (path) => attempt(() => change(path, {}));

// ---- events

function handle(event) {
  switch (event.event) {
    case "state":
      state = event;
      if (view.digest !== event.digest || !view.nodes) refresh();
      else { for (const node of view.nodes) graph.update(node.id, state.nodes[node.id]); outputs(); }
      historyPane();
      break;
    case "graph":
      [state.mistakes, state.problem] = [event.mistakes, event.problem];
      refresh();
      break;
    case "mistakes":
      state.mistakes = event.list;
      state.problem = event.list.length ? null : event.text;
      [view.mistakes, view.problem] = [state.mistakes, state.problem];
      texts();
      break;
    case "history":
      state.history = event.history;
      historyPane();
      break;
    case "start": case "node": case "values":
      state.running = state.running || event.event === "start";
      state.nodes[event.id] = event.node;
      graph.update(event.id, event.node);
      if (event.id === chosen) nodePane();
      if (event.event !== "start") { outputs(); place?.changed(); if (place) picked(); }
      break;
    case "progress":
      state.nodes[event.id] = { ...state.nodes[event.id], status: "running", fraction: event.fraction };
      graph.update(event.id, state.nodes[event.id]);
      break;
    case "plan": [state.plan, state.running] = [event, true]; break;
    case "pass": [state.pass, state.running] = [event, true]; break;
    case "done":
      if (!state.pass && !event.stopped) {
        for (const [id, node] of Object.entries(state.nodes)) {
          if (node.preview) { node.preview = false; graph.update(id, node); }
        }
      }
      [state.done, state.pass] = [{ ...event, at: Date.now() / 1000 }, null];
      if (state.nodes[chosen]) nodePane();
      break;
    case "idle":
      [state.running, state.pass, state.plan] = [false, null, null];
      for (const [id, node] of Object.entries(state.nodes)) {
        if (node.status === "running") { node.status = "skipped"; graph.update(id, node); }
      }
      // An output that the graph has no more is replaced only now.
      outputs();
      break;
    case "warning": state.warnings = [...state.warnings, event.text].slice(-20); historyPane(); break;
    default: break;
  }
  status();
}

// ---- keys

const KEYS = [
  ["arrows", "move between nodes of the graph", null],
  ["f", "flip between A and B", () => picture.set(picture.mode() === 2 ? 0 : 2)],
  ["s", "A and B side by side with a slider", () => picture.set(1)],
  ["d", "difference of A and B", () => picture.set(3)],
  ["[ ]", "less or more exposure", null],
  ["0", "fit the picture into the pane", () => picture.fit()],
  ["1", "one picture pixel per screen pixel", () => picture.whole()],
  ["b", "look around in a panorama", () => picture.round()],
  ["+ -", "zoom", null],
  ["p", "picture or place", () => pane($("place").hidden)],
  ["t", "text or nodes", () => tab($("text").hidden)],
  ["Ctrl+Z", "undo the last change of the text", null],
  ["Ctrl+Shift+Z", "redo", null],
  ["Escape", "while a value is edited: back to the text", null],
  ["?", "this list", () => $("keys").showModal()],
  ["W A S D Q E", "in the place: fly", null],
  ["arrows, page up and down", "in the place: move the object by 1 cm, with Shift by 10 cm", null],
  [", .", "in the place: turn the object by 5 degrees", null],
  ["g", "in the place: put the object on the ground below it", null],
  ["x", "in the place: click where the object shall stand", null],
  ["c", "in the place: look through the next camera", null],
  ["Enter", "in the place: set the camera to this view", null],
  ["0 f", "in the place: see all of it, or the object", null],
  ["o", "in the place: the traced picture over the view of its camera", null],
];

function exposure(by) {
  $("exposure").value = Number($("exposure").value) + by;
  $("exposure").dispatchEvent(new Event("input"));
}

document.addEventListener("keydown", (event) => {
  const typing = event.target.matches?.('input[type="text"], textarea, select:not(#other, #mode), dialog *');
  // In a field that was typed into, Ctrl+Z takes back the typing.
  const typed = typing && event.target.value !== event.target.defaultValue;
  if ((event.ctrlKey || event.metaKey) && ["z", "y"].includes(event.key.toLowerCase()) && !typed) {
    event.preventDefault();
    step(event.shiftKey || event.key.toLowerCase() === "y" ? "/redo" : "/undo");
    return;
  }
  if (typing || event.ctrlKey || event.metaKey || event.altKey || event.target.matches?.('input[type="range"]') && !"?fsdt".includes(event.key)) return;
  const onControl = event.target.matches?.('#place button, #place input[type="checkbox"]') && !["Enter", " "].includes(event.key);
  const inPlace = !$("place").hidden && (event.target === document.body || event.target === $("space") || onControl);
  if (inPlace && place?.key(event)) { event.preventDefault(); return; }
  const more = { "[": () => exposure(-0.5), "]": () => exposure(0.5), "+": () => picture.zoom(1.5), "=": () => picture.zoom(1.5), "-": () => picture.zoom(1 / 1.5) };
  const action = more[event.key] ?? KEYS.find(([key]) => key === event.key)?.[2];
  if (action) { event.preventDefault(); action(); }
});

show($("key-list"), KEYS.map(([key, what]) => [el("dt", {}, key), el("dd", {}, what)]).flat());
$("help").addEventListener("click", () => $("keys").showModal());
$("undo").addEventListener("click", () => step("/undo"));
$("redo").addEventListener("click", () => step("/redo"));
$("tab-picture").addEventListener("click", () => pane(false));
$("tab-place").addEventListener("click", () => pane(true));
$("tab-graph").addEventListener("click", () => tab(false));
$("tab-text").addEventListener("click", () => tab(true));
$("output").addEventListener("change", () => { output = $("output").value; outputs(); });
$("layer").addEventListener("change", draw);
$("axis").addEventListener("input", () => {
  output = siblings()[Number($("axis").value)] ?? output;
  outputs();
  place?.changed();
  if (place) picked();
});
$("other").addEventListener("change", () => { if (picture.mode() === 0) picture.set(1); draw(); });
$("theme").addEventListener("click", () => {
  const dark = document.documentElement.dataset.theme ? document.documentElement.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  document.documentElement.dataset.theme = dark ? "light" : "dark";
  try { localStorage.setItem("theme", document.documentElement.dataset.theme); } catch { /* storage may be off */ }
});
try { const theme = localStorage.getItem("theme"); if (theme) document.documentElement.dataset.theme = theme; } catch { /* storage may be off */ }
if (picture.failure()) notify(picture.failure());

try {
  await enter();
  listen(handle, (now) => { connected = now; status(); });
} catch (error) {
  notify(error.message);
}
