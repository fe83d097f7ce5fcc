// The graph as SVG: nodes from top to bottom, with state, progress, time and a thumbnail.
import { $, el, large, seconds, show, svg } from "./dom.js";

const [WIDTH, HEIGHT, GAP_X, GAP_Y, MARGIN] = [158, 52, 12, 26, 10];
// Width of a place where only a wire passes.
const PASS = 8;
// Factor of the drawing on a large screen.
const LARGE = 1.45;
const DRAWN = ["image", "views", "pano", "env", "brackets"];

export const shows = (output) => DRAWN.includes(output.type) || output.type === "report";

export function Graph(choose) {
  let view = null;
  let boxes = [];
  let chosen = null;
  const place = $("graph");

  // The steps of the graph are rows from top to bottom. Left edge and width of each entry, and the total width.
  let places = [];
  let total = 0;

  function lay() {
    const width = ([, passes]) => (passes ? PASS : WIDTH);
    const widths = view.columns.map((entries) => entries.reduce((sum, entry) => sum + width(entry) + GAP_X, -GAP_X));
    total = Math.max(0, ...widths) + 2 * MARGIN;
    places = view.columns.map((entries, step) => {
      let x = (total - widths[step]) / 2;
      return entries.map((entry) => {
        const place = { x, width: width(entry) };
        x += place.width + GAP_X;
        return place;
      });
    });
  }

  const y = (step) => MARGIN + step * (HEIGHT + GAP_Y);
  const middle = (step, at) => places[step][at].x + places[step][at].width / 2;

  function wires() {
    return view.segments.map(([step, from, to]) => {
      const [x0, y0, x1, y1] = [middle(step, from), y(step) + HEIGHT, middle(step + 1, to), y(step + 1)];
      const through = view.columns[step + 1][to][1] ? ` V${y1 + HEIGHT}` : "";
      const bend = GAP_Y * 0.7;
      const line = svg("path", { class: "wire", d: `M${x0} ${y0} C${x0} ${y0 + bend} ${x1} ${y1 - bend} ${x1} ${y1}${through}` });
      line.ends = [view.columns[step][from][0], view.columns[step + 1][to][0]];
      return line;
    });
  }

  function box(index, step, at) {
    const node = view.nodes[index];
    const parts = {
      time: svg("text", { class: "time", x: 11, y: 46 }),
      title: svg("title"),
      progress: svg("rect", { class: "progress", x: 0, y: HEIGHT - 3, width: 0, height: 3, rx: 1 }),
      image: svg("image", { x: WIDTH - 49, y: 5, width: 44, height: HEIGHT - 20, preserveAspectRatio: "xMaxYMin meet" }),
    };
    const name = node.id.length > 15 ? `${node.id.slice(0, 14)}…` : node.id;
    const group = svg("g", {
      class: "node", tabindex: -1, role: "button", transform: `translate(${places[step][at].x} ${y(step)})`, "aria-label": `${node.id}, ${node.kind}`,
      onclick: () => choose(node.id), onkeydown: (event) => key(event, index),
    },
    parts.title,
    svg("rect", { class: "box", width: WIDTH, height: HEIGHT, rx: 6 }),
    svg("rect", { class: "light", width: 5, height: HEIGHT, rx: 2 }),
    svg("text", { x: 11, y: 17, "font-weight": "600" }, name),
    svg("text", { class: "kind", x: 11, y: 32 }, node.kind),
    parts.time, parts.progress, parts.image);
    return { ...parts, group, step, at };
  }

  // The whole graph, after it changed.
  function draw(next, nodes) {
    view = next;
    if (!view.nodes) return show(place, el("p", { class: "dim" }, "The graph has mistakes; see the text."));
    if (!view.columns) return list(nodes);
    boxes = [];
    lay();
    view.columns.forEach((entries, step) => entries.forEach(([index, passes], at) => {
      if (!passes) boxes[index] = box(index, step, at);
    }));
    const [width, height] = [total, y(view.columns.length) - GAP_Y + MARGIN];
    const lines = wires();
    const k = large() ? LARGE : 1;
    const drawing = svg("svg", { width: width * k, height: height * k, viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": "Graph" },
      lines, boxes.map((one) => one.group));
    drawing.lines = lines;
    // A wide graph is made smaller, but stays readable; the rest is scrolled to.
    drawing.style.minWidth = `${Math.round(width * k * 0.66)}px`;
    show(place, drawing);
    view.nodes.forEach((node) => update(node.id, nodes[node.id]));
    mark(chosen);
  }

  // A graph that is too large to draw.
  function list(nodes) {
    boxes = [];
    const row = (node) => el("li", {}, el("button", { type: "button", onclick: () => choose(node.id) },
      `${node.id} · ${node.kind} · ${nodes[node.id]?.status ?? "unknown"}`));
    show(place, el("p", {}, "This graph is too large to draw."), el("ul", {}, view.nodes.slice(0, 2000).map(row)));
  }

  // One node, after an event.
  function update(id, state) {
    const index = view?.nodes?.findIndex((node) => node.id === id) ?? -1;
    const one = boxes[index];
    if (!one) return;
    const { status = "unknown", fraction = 0, seconds: took = 0, forecast = null, error, notes = [], outputs = [], degraded, preview } = state ?? {};
    one.group.setAttribute("class", `node ${status}${id === chosen ? " chosen" : ""}`);
    const time = status === "running" ? `${Math.round(fraction * 100)} %${forecast ? ` of ${seconds(forecast)}` : ""}`
      : status === "ran" ? seconds(took) : status;
    const worst = degraded ? " · degraded" : notes.some((note) => note.level === "warning") ? " · warning" : "";
    one.time.textContent = `${time === "unknown" ? "" : time}${preview && status === "ran" ? " · preview" : ""}${worst}`;
    one.title.textContent = [`${id}: ${view.nodes[index].kind}`, error, ...notes.map((note) => note.text)].filter(Boolean).join("\n");
    one.progress.setAttribute("width", status === "running" ? WIDTH * fraction : 0);
    const drawn = outputs.find((output) => DRAWN.includes(output.type) && output.stored);
    const href = drawn ? `/value/${drawn.digest}/0.png?size=96` : "";
    if (one.image.getAttribute("href") !== href) {
      if (href) one.image.setAttribute("href", href); else one.image.removeAttribute("href");
    }
  }

  // Emphasises a node and its wires.
  function mark(id) {
    chosen = id;
    const index = view?.nodes?.findIndex((node) => node.id === id) ?? -1;
    boxes.forEach((one, at) => {
      one.group.classList.toggle("chosen", at === index);
      one.group.setAttribute("tabindex", at === Math.max(index, 0) ? 0 : -1);
    });
    for (const line of place.querySelector("svg")?.lines ?? []) line.classList.toggle("near", line.ends.includes(index));
  }

  // Emphasises the nodes that an edit would run.
  function would(ids) {
    boxes.forEach((one, at) => one.group.classList.toggle("would", ids.includes(view.nodes[at].id)));
  }

  function key(event, index) {
    const one = boxes[index];
    const all = boxes.map((box, index) => ({ box, index })).filter(({ box }) => box);
    const near = (step) => {
      const there = all.filter(({ box }) => box.step === step);
      const away = ({ box }) => Math.abs(middle(box.step, box.at) - middle(one.step, one.at));
      return there.sort((a, b) => away(a) - away(b))[0];
    };
    const row = all.filter(({ box }) => box.step === one.step).sort((a, b) => a.box.at - b.box.at);
    const found = {
      ArrowDown: () => near(one.step + 1), ArrowUp: () => near(one.step - 1),
      ArrowRight: () => row.filter(({ box }) => box.at > one.at)[0],
      ArrowLeft: () => row.filter(({ box }) => box.at < one.at).pop(),
      Enter: () => ({ index }), " ": () => ({ index }),
    }[event.key]?.();
    if (!found) return;
    event.preventDefault();
    choose(view.nodes[found.index].id);
    boxes[found.index].group.focus();
  }

  return { draw, update, mark, would };
}
