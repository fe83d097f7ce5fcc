// The pane of the chosen node: its state, notes and outputs, and editors of its parameters.
import { $, el, seconds, show } from "./dom.js";
import { field, flowing } from "./fields.js";
import { shows } from "./graph.js";

// Types of values that the place view shows.
const IN_PLACE = ["splats", "mesh", "rig", "pose", "placed"];

// `page` gives the graph (`view`), the state (`state`) and the chosen node (`chosen`); `edits` edits parameters, and
// `output` is called with the output that the user wants to see.
export function NodePane(page, edits, output) {
  let shown = "";
  // True if the parameters without a value are shown.
  let opened = false;

  // The instances of a node along axes.
  const instances = (node) => ({ id: node.id, ids: page.view.nodes.filter((one) => one.in_file === node.in_file).map((one) => one.id) });

  // `force` replaces editors that show another value than the text.
  function draw(force = false) {
    const node = page.view.nodes?.find((one) => one.id === page.chosen);
    if (!node) return show($("node"), el("p", { class: "dim" }, "No node is chosen."));
    const kind = page.view.kinds[node.kind];
    const now = page.state.nodes[node.id] ?? {};
    const signature = JSON.stringify([node.id, node.values, page.view.confined]);
    // A slider is not replaced while it is dragged.
    if (!force && (signature === shown || edits.drags())) return facts(node, now);
    shown = signature;
    const focus = document.activeElement?.closest?.("#node") ? document.activeElement.getAttribute("aria-label") : null;
    const fixed = page.view.confined ? "This graph belongs to an unpacked bundle, whose files are never written."
      : node.span === null ? "Another file defines this node; edit it there." : null;
    const value = (param) => node.values[param.name] ?? { value: param.default, text: null };
    const editor = (param) => field(param, value(param), { ...edits.of(node, param), go: page.go }, fixed, instances(node));
    // Optional parameters without a value take no place.
    const unset = kind.params.filter((param) => value(param).text === null && value(param).value === "None");
    const shownParams = kind.params.filter((param) => !unset.includes(param));
    show($("node"), el("h2", {}, `${node.id}: ${node.kind}`), el("div", { id: "facts" }), el("div", { class: "dim", id: "plan", role: "status" }),
      shownParams.map(editor),
      unset.length ? el("details", { class: "unset", open: opened, ontoggle: (event) => { opened = event.target.open; } }, el("summary", {}, `Not set: ${unset.map((param) => param.name).join(", ")}`),
        unset.map(editor)) : null,
      el("details", { class: "doc" }, el("summary", {}, "About this kind"), el("p", {}, flowing(kind.doc))));
    // A control that has the focus again is not one that the user has come to.
    if (focus) { $("node").querySelector(`[aria-label="${CSS.escape(focus)}"]`)?.focus(); edits.plan(null); }
    return facts(node, now);
  }

  function facts(node, now) {
    const time = now.status === "running" ? `running, ${Math.round(now.fraction * 100)} %${now.forecast ? ` of about ${seconds(now.forecast)}` : ""}`
      : `${now.status ?? "unknown"}${now.seconds ? `, ${seconds(now.seconds)} (${seconds(now.cpu_seconds)} of CPU time)` : ""}${now.preview ? ", preview" : ""}`;
    const place = $("facts");
    if (!place) return;
    const inPlace = (out) => IN_PLACE.includes(out.type);
    const button = (out) => el("button", {
      type: "button", disabled: !shows(out) && !inPlace(out),
      title: shows(out) ? `Show it (${out.type})` : inPlace(out) ? `Show it in the place (${out.type})` : `Values of the type ${out.type} are not shown`,
      onclick: () => (inPlace(out) ? page.reveal(node.id, out.type) : output(`${node.id}.${out.port}`)),
    }, out.port);
    show(place, el("p", { class: "dim" }, `${time}${node.line ? `; line ${node.line}` : ""}`), now.error && el("p", { class: "error" }, now.error),
      now.outputs?.length ? el("div", { class: "outputs" }, now.outputs.map(button)) : null,
      now.notes?.length ? notes(now.notes) : null);
  }

  // Warnings are shown at once; the rest can be opened.
  let open = false;
  function notes(all) {
    const item = (note) => el("li", { class: `note ${note.level}` }, note.text);
    const urgent = all.filter((note) => ["warning", "degraded"].includes(note.level));
    const rest = all.filter((note) => !urgent.includes(note));
    const more = rest.length ? el("details", { open, ontoggle: (event) => { open = event.target.open; } },
      el("summary", {}, `${rest.length} ${rest.length > 1 ? "notes" : "note"}`), el("ul", { class: "list" }, rest.map(item))) : null;
    return [urgent.length ? el("ul", { class: "list" }, urgent.map(item)) : null, more].filter(Boolean);
  }

  return { draw };
}
