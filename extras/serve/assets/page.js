// The page: follows the events of the watch, and connects the panes.
import { $, clock, el, seconds, show } from "./dom.js";
import { enter, json, listen, LOST } from "./server.js";
import { Edits } from "./edits.js";
import { Graph, shows } from "./graph.js";
import { Keys } from "./keys.js";
import { Measures } from "./measures.js";
import { NodePane } from "./node.js";
import { Outputs } from "./outputs.js";
import { Picture } from "./picture.js";
import { Text } from "./text.js";

// What the panes share: the state of the run, the graph, and the chosen node.
const page = {
  state: { nodes: {}, mistakes: [], files: {}, warnings: [], history: { shots: [] }, refinements: [] },
  view: { digest: null, mistakes: [] },
  chosen: null,
  notify,
  attempt,
  refresh,
  // Shows another place along an axis.
  go: (axis, place) => { outputs.move(axis, place); follow((id) => outputs.moved(id, axis, place)); },
  // Shows a value in the place view.
  reveal: async (id, type) => { await pane("place"); await place?.reveal(id, type); },
  open: (name) => choose(page.view.nodes?.find((node) => node.id === name || node.in_file === name)?.id ?? page.chosen),
};
let connected = false;

const graph = Graph(choose);
const text = Text();
const edits = Edits(page, (ids) => graph.would(ids), () => nodePane.draw(true));
const picture = Picture((side, about, error) => {
  if (error) notify(side === "a" ? error.message : `B: ${error.message}`);
  else if (side === "a") { outputs.layers(about); picture.tables(about.report); }
  lights();
  measures.update();
}, () => emitters?.draw());
const outputs = Outputs(page, picture);
const measures = Measures(page, picture);
const nodePane = NodePane(page, edits, outputs.choose);
// Parts whose code is loaded when they are used for the first time: the place view, the trade pane, and the marks on
// panoramas.
let [place, trade, emitters] = [null, null, null];

async function lights() {
  if (!emitters && !picture.isRound()) return;
  const { Emitters } = await import("/assets/emitters.js");
  emitters ??= Emitters(page, outputs, picture);
  emitters.update();
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
  const { pass, plan, done, running, mistakes, problem, history } = page.state;
  const failed = mistakes.length + (problem ? 1 : 0);
  const line = !connected ? "not connected; waiting for `lightharmony watch --serve`"
    : failed ? `${problem ?? `${mistakes.length} mistake${mistakes.length > 1 ? "s" : ""}`}; the last good result is shown`
    : running ? [pass ? `preview: ${pass.level} of ${pass.of} ${pass.parameter}${pass.coarse > 1 ? `, blocks of ${pass.coarse} px` : ""}` : "running",
      plan?.open ? `${plan.open} nodes, ${plan.untimed ? `${plan.untimed} of them never timed` : `about ${seconds(plan.seconds)}`}` : ""].filter(Boolean).join("; ")
    : done ? `up to date; ${done.ran} ran, ${done.cached} cached, ${seconds(done.seconds)}, at ${clock(done.at)}` : "up to date";
  $("status").textContent = line + (history.tried?.length ? "; trying a value" : "");
  $("status").className = failed || !connected ? "failed" : running ? "running" : "";
}

// ---- the graph

let fetching = null;
// Digest of a first graph, until the page shows it: its pose is then chosen.
let started = null;
async function refresh() {
  // One request at a time; one more if the graph changed meanwhile.
  if (fetching) { fetching.again = true; return; }
  fetching = {};
  await attempt(async () => {
    page.view = await json("/graph");
    const { view } = page;
    edits.fetched(view.digest);
    if (started === view.digest) [started, page.chosen] = [null, null];
    document.title = `${view.name?.split("/").pop() ?? "graph"} · lightharmony`;
    $("name").textContent = view.name ?? "lightharmony";
    if (!view.nodes?.some((node) => node.id === page.chosen)) page.chosen = view.nodes?.find((node) => node.kind === "Pose")?.id ?? view.nodes?.[0]?.id ?? null;
    graph.draw(view, page.state.nodes);
    graph.mark(page.chosen);
    outputs.update();
    nodePane.draw();
    texts();
    place?.changed();
    trade?.changed();
    begin();
  });
  const { again } = fetching;
  fetching = null;
  if (again) await refresh();
}

let mistakesShown = "";
function texts() {
  const { view } = page;
  const node = view.nodes?.find((one) => one.id === page.chosen);
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
  page.chosen = id;
  graph.mark(id);
  nodePane.draw();
  texts();
  const line = page.view.nodes.find((node) => node.id === id)?.line;
  if (!$("text").hidden && line) text.scroll(line);
  const first = (page.state.nodes[id]?.outputs ?? []).find(shows);
  if (first) outputs.choose(`${id}.${first.port}`);
}

// ---- panes in the middle

// A bare capture is shown as a place at once.
let begun = false;
async function begin() {
  if (begun) return;
  begun = true;
  if (page.view.nodes && !page.view.nodes.some((node) => node.kind === "PathTrace") && page.view.starts) await pane("place");
}

// Puts an object into a bare capture; the new graph then shows its pose.
const start = (data) => attempt(async () => {
  // The new graph comes before this answer or after it.
  started = (await edits.change("/start", data)).digest;
  await refresh();
  return true;
});

// Turns a bare capture, so that another of its axes points up.
const turn = (up) => attempt(() => edits.change("/up", { up }).then(() => true));

// Adds an object to the graph; gives the answer of the server.
const add = (data) => attempt(() => edits.change("/add", data));

async function pane(name) {
  for (const one of ["picture", "place", "trade"]) {
    $(one).hidden = one !== name;
    $(`tab-${one}`).setAttribute("aria-pressed", String(one === name));
  }
  if (name === "picture") return picture.redraw();
  return attempt(async () => {
    if (name === "trade") {
      const { Trade } = await import("/assets/trade.js");
      trade ??= Trade(page, edits, outputs);
      trade.open();
      return;
    }
    const { Place } = await import("/assets/place.js");
    place ??= Place({ graph: () => page.view, state: () => page.state, picture: outputs.made, along: outputs.here, set: edits.set, attempt: edits.attempt, revert: edits.revert, choose, notify, start, turn, add, plan: edits.plan });
    place.open();
    await outputs.pick(place.pictured);
  });
}

// ---- history

function historyPane() {
  const { undo = 0, redo = 0, last, next, problem, shots = [] } = page.state.history;
  $("undo").disabled = !undo;
  $("redo").disabled = !redo;
  $("undo").title = undo ? `Undo: ${last} (Ctrl+Z)` : "Nothing to undo";
  $("redo").title = redo ? `Redo: ${next} (Ctrl+Shift+Z)` : "Nothing to redo";
  const entry = (shot) => el("li", {}, el("button", { type: "button", class: "plain", title: "Compare the picture with this result", onclick: () => { pane("picture"); outputs.against(shot); } }, `${clock(shot.seconds)} ${shot.label}`));
  show($("history"), el("h3", {}, "History"), problem && el("p", { class: "warning" }, problem),
    page.state.warnings.map((warning) => el("p", { class: "warning" }, warning)),
    el("p", { class: "dim" }, `Can be undone: ${undo}, redone: ${redo}.`),
    el("ul", { class: "list" }, shots.slice(-12).toReversed().map(entry)));
  outputs.others();
  status();
  trade?.changed();
}

const step = (path) => attempt(() => edits.change(path, {}));

// ---- events

function handle(event) {
  const { state } = page;
  switch (event.event) {
    case "state":
      page.state = event;
      if (page.view.digest !== event.digest || !page.view.nodes) refresh();
      else { for (const node of page.view.nodes) graph.update(node.id, event.nodes[node.id]); outputs.update(); }
      historyPane();
      outputs.look();
      place?.changed();
      if (place) outputs.pick(place.pictured);
      break;
    case "graph":
      [state.mistakes, state.problem] = [event.mistakes, event.problem];
      refresh();
      break;
    case "mistakes":
      state.mistakes = event.list;
      state.problem = event.list.length ? null : event.text;
      [page.view.mistakes, page.view.problem] = [state.mistakes, state.problem];
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
      if (event.id === page.chosen) nodePane.draw();
      if (event.event !== "start") { outputs.update(); place?.changed(); if (place) outputs.pick(place.pictured); }
      break;
    case "progress":
      state.nodes[event.id] = { ...state.nodes[event.id], status: "running", fraction: event.fraction };
      graph.update(event.id, state.nodes[event.id]);
      break;
    case "plan": [state.plan, state.running] = [event, true]; break;
    case "pass": [state.pass, state.running] = [event, true]; break;
    case "done":
      if (!event.stopped) edits.previewed();
      if (!state.pass && !event.stopped) {
        for (const [id, node] of Object.entries(state.nodes)) {
          if (node.preview) { node.preview = false; graph.update(id, node); }
        }
      }
      [state.done, state.pass, state.refinements] = [{ ...event, at: Date.now() / 1000 }, null, event.refinements ?? []];
      if (state.nodes[page.chosen]) nodePane.draw();
      break;
    case "idle":
      [state.running, state.pass, state.plan] = [false, null, null];
      for (const [id, node] of Object.entries(state.nodes)) {
        if (node.status === "running") { node.status = "skipped"; graph.update(id, node); }
      }
      // An output that the graph has no more is replaced only now.
      outputs.update();
      outputs.look();
      place?.changed();
      if (place) outputs.pick(place.pictured);
      measures.update();
      trade?.changed();
      break;
    case "file": state.files[event.path] = event; outputs.written(); break;
    case "warning": state.warnings = [...state.warnings, event.text].slice(-20); historyPane(); break;
    default: break;
  }
  status();
}

// After the place along the axes changed: chooses an instance of the chosen node, and updates the place view.
function follow(instance) {
  const id = page.chosen && instance(page.chosen);
  if (id && page.view.nodes.some((node) => node.id === id)) {
    page.chosen = id;
    graph.mark(id);
    nodePane.draw();
  }
  place?.changed();
  if (place) outputs.pick(place.pictured);
}

// ---- controls

function exposure(by) {
  $("exposure").value = Number($("exposure").value) + by;
  $("exposure").dispatchEvent(new Event("input"));
}

// Sets the mode of the comparison.
function mode(next) {
  picture.set(next);
  measures.update();
}

Keys({
  flip: () => mode(picture.mode() === 2 ? 0 : 2), mode, fit: picture.fit, whole: picture.whole, round: picture.round, zoom: picture.zoom,
  pane, text: () => tab($("text").hidden), step, exposure,
}, () => place);
$("undo").addEventListener("click", () => step("/undo"));
$("redo").addEventListener("click", () => step("/redo"));
for (const one of ["picture", "place", "trade"]) $(`tab-${one}`).addEventListener("click", () => pane(one));
$("tab-graph").addEventListener("click", () => tab(false));
$("tab-text").addEventListener("click", () => tab(true));
$("mode").addEventListener("input", measures.update);
$("theme").addEventListener("click", () => {
  const { dataset } = document.documentElement;
  const dark = dataset.theme ? dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  dataset.theme = dark ? "light" : "dark";
  try { localStorage.setItem("theme", dataset.theme); } catch { /* storage may be off */ }
});
try { const theme = localStorage.getItem("theme"); if (theme) document.documentElement.dataset.theme = theme; } catch { /* storage may be off */ }
if (picture.failure()) notify(picture.failure());

try {
  await enter();
  listen(handle, (now) => {
    connected = now;
    if (now && $("notice").textContent.startsWith(LOST)) notify(null);
    status();
  });
} catch (error) {
  notify(error.message);
}
