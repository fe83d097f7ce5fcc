// The graph as SVG: nodes in columns, with state, progress, time and a thumbnail.
import { $, el, seconds, show, svg } from "./dom.js";

const [WIDTH, HEIGHT, GAP_X, GAP_Y, MARGIN] = [216, 62, 44, 14, 14];
const DRAWN = ["image", "views", "pano", "env", "brackets"];

export const shows = (output) => DRAWN.includes(output.type) || output.type === "report";

export function Graph(choose) {
  let view = null;
  let boxes = [];
  let chosen = null;
  const place = $("graph");

  function x(column) { return MARGIN + column * (WIDTH + GAP_X); }
  function y(row) { return MARGIN + row * (HEIGHT + GAP_Y); }

  function wires() {
    return view.segments.map(([column, from, to]) => {
      const [x0, y0, x1, y1] = [x(column) + WIDTH, y(from) + HEIGHT / 2, x(column + 1), y(to) + HEIGHT / 2];
      const through = view.columns[column + 1][to][1] ? ` H${x1 + WIDTH}` : "";
      const bend = GAP_X / 2;
      const line = svg("path", { class: "wire", d: `M${x0} ${y0} C${x0 + bend} ${y0} ${x1 - bend} ${y1} ${x1} ${y1}${through}` });
      line.ends = [view.columns[column][from][0], view.columns[column + 1][to][0]];
      return line;
    });
  }

  function box(index, column, row) {
    const node = view.nodes[index];
    const parts = {
      time: svg("text", { class: "time", x: 12, y: 54 }),
      title: svg("title"),
      progress: svg("rect", { class: "progress", x: 0, y: HEIGHT - 3, width: 0, height: 3 }),
      image: svg("image", { x: WIDTH - 58, y: 6, width: 52, height: HEIGHT - 14, preserveAspectRatio: "xMidYMid meet" }),
    };
    const name = node.id.length > 19 ? `${node.id.slice(0, 18)}…` : node.id;
    const group = svg("g", {
      class: "node", tabindex: -1, role: "button", transform: `translate(${x(column)} ${y(row)})`,
      onclick: () => choose(node.id), onkeydown: (event) => key(event, index),
    },
    parts.title,
    svg("rect", { class: "box", width: WIDTH, height: HEIGHT, rx: 6 }),
    svg("rect", { class: "light", width: 5, height: HEIGHT, rx: 2 }),
    svg("text", { x: 12, y: 20, "font-weight": "600" }, name),
    svg("text", { class: "kind", x: 12, y: 37 }, node.kind),
    parts.time, parts.progress, parts.image);
    return { ...parts, group, column, row };
  }

  // The whole graph, after it changed.
  function draw(next, nodes) {
    view = next;
    if (!view.nodes) return show(place, el("p", { class: "dim" }, "The graph has mistakes; see the text."));
    if (!view.columns) return list(nodes);
    boxes = [];
    view.columns.forEach((entries, column) => entries.forEach(([index, passes], row) => {
      if (!passes) boxes[index] = box(index, column, row);
    }));
    const rows = Math.max(0, ...view.columns.map((entries) => entries.length));
    const [width, height] = [x(view.columns.length) - GAP_X + MARGIN, y(rows) - GAP_Y + MARGIN];
    const lines = wires();
    const drawing = svg("svg", { width, height, viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": "Graph" },
      lines, boxes.map((one) => one.group));
    drawing.lines = lines;
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
    const near = (column, row) => {
      const there = boxes.map((box, at) => ({ box, at })).filter(({ box }) => box && box.column === column);
      return there.sort((a, b) => Math.abs(a.box.row - row) - Math.abs(b.box.row - row))[0];
    };
    const rows = boxes.map((box, at) => ({ box, at })).filter(({ box }) => box?.column === one.column);
    const found = {
      ArrowRight: () => near(one.column + 1, one.row), ArrowLeft: () => near(one.column - 1, one.row),
      ArrowDown: () => rows.filter(({ box }) => box.row > one.row)[0],
      ArrowUp: () => rows.filter(({ box }) => box.row < one.row).pop(),
      Enter: () => ({ box: one, at: index }), " ": () => ({ box: one, at: index }),
    }[event.key]?.();
    if (!found) return;
    event.preventDefault();
    choose(view.nodes[found.at].id);
    boxes[found.at].group.focus();
  }

  return { draw, update, mark, would };
}
