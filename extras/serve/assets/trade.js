// The trade pane: error against time for the picture at hand, presets, and what was modelled or left out.
import { $, el, number, seconds, show, svg } from "./dom.js";
import { json, post } from "./server.js";

// Size of the chart in pixels, and its margins.
const [WIDTH, HEIGHT, LEFT, BOTTOM, TOP] = [520, 220, 58, 40, 14];
// Pictures of previews that are compared, at most.
const MOST_POINTS = 24;

// `page` gives the graph (`view`), the state (`state`), `attempt` and `open` (a node); `edits` writes and `outputs` has
// the picture.
export function Trade(page, edits, outputs) {
  let shown = "";
  let again = null;

  const isOpen = () => !$("trade").hidden;

  // Called when results, the graph or the state changed.
  function changed() {
    if (!isOpen()) return;
    clearTimeout(again);
    again = setTimeout(update, 250);
  }

  let busy = false;
  async function update() {
    // While a run goes, the machine computes the picture.
    if (busy || !isOpen()) return;
    busy = true;
    try {
      const name = outputs.favourite();
      $("trade-name").textContent = name ? `of ${name}` : "";
      const signature = JSON.stringify([page.view.digest, page.state.refinements?.length, page.state.running, page.state.history.tried, page.state.done?.at]);
      if (signature !== shown) {
        shown = signature;
        if (!page.state.running) { await chart(name); await tables(); }
      }
    } catch (error) {
      page.notify(error.message);
    }
    busy = false;
  }

  // ---- error against time

  // The mean FLIP of the picture of each preview against the last picture.
  async function points(name) {
    const all = (page.state.refinements ?? []).filter((one) => one.values[name]);
    const last = all.at(-1)?.values[name][1];
    const found = [];
    for (const one of all.slice(-MOST_POINTS)) {
      const digest = one.values[name][1];
      if (digest === last) { found.push({ ...one, flip: 0, psnr: Infinity }); continue; }
      try {
        const { report } = await json(`/difference/${digest}/0/${last}/0`);
        const table = report.tables[0];
        const cell = (column) => table.rows[0][table.columns.findIndex((one) => one.startsWith(column))];
        found.push({ ...one, flip: cell("flip mean"), psnr: cell("psnr") });
      } catch { /* the picture of this preview is gone */ }
    }
    return found;
  }

  // Estimate of the noise of the last picture, as a part of white. Its first n of N samples are those of the preview, so
  // the variance of their difference is that of N samples, times (N - n) / n.
  function noise(preview) {
    const { parameter, level, of, coarse } = preview?.pass ?? {};
    if (parameter !== "samples" || coarse > 1 || !(level < of) || !Number.isFinite(preview.psnr)) return null;
    return Math.sqrt(10 ** (-preview.psnr / 10) * (level / (of - level)));
  }

  async function chart(name) {
    const all = name ? await points(name) : [];
    const compared = all.filter((one) => one.flip > 0);
    if (!compared.length) {
      show($("trade-chart"), el("p", { class: "dim" }, "There are no previews to compare with the result: the run was short, or everything was cached. The chart appears after a run with previews."));
      return;
    }
    const end = Math.max(...all.map((one) => one.seconds));
    const [low, high] = [Math.min(...compared.map((one) => one.flip)), Math.max(...compared.map((one) => one.flip))];
    const [bottom, top] = [Math.floor(Math.log10(low)), Math.max(Math.ceil(Math.log10(high)), Math.floor(Math.log10(low)) + 1)];
    const x = (t) => LEFT + (t / end) * (WIDTH - LEFT - 16);
    const y = (v) => TOP + ((top - Math.log10(v)) / (top - bottom)) * (HEIGHT - TOP - BOTTOM);
    const label = ({ pass }) => (pass ? `${pass.level} of ${pass.of} ${pass.parameter}${pass.coarse > 1 ? `, blocks of ${pass.coarse} px` : ""}` : "the result");
    const parts = [];
    const steps = top - bottom > 2 ? [1] : [1, 2, 5];
    for (let power = bottom; power <= top; power += 1) {
      for (const value of steps.map((step) => step * 10 ** power).filter((one) => one <= 10 ** top * 1.001)) {
        const at = y(value);
        parts.push(svg("line", { class: "grid", x1: LEFT, x2: WIDTH - 16, y1: at, y2: at }), svg("text", { class: "tick", x: LEFT - 6, y: at + 4, "text-anchor": "end" }, number(Number(value.toPrecision(2)))));
      }
    }
    for (let i = 0; i <= 4; i += 1) parts.push(svg("text", { class: "tick", x: x((end * i) / 4), y: HEIGHT - BOTTOM + 16, "text-anchor": i < 4 ? "middle" : "end" }, i ? seconds((end * i) / 4) : "0"));
    parts.push(svg("text", { class: "tick", x: (LEFT + WIDTH) / 2, y: HEIGHT - 4, "text-anchor": "middle" }, "time since the start of the run"),
      svg("text", { class: "tick", x: 12, y: (HEIGHT - BOTTOM) / 2, "text-anchor": "middle", transform: `rotate(-90 12 ${(HEIGHT - BOTTOM) / 2})` }, "mean FLIP"),
      svg("polyline", { class: "curve", points: compared.map((one) => `${x(one.seconds)},${y(one.flip)}`).join(" ") }),
      compared.map((one) => svg("circle", { class: "point", cx: x(one.seconds), cy: y(one.flip), r: 4.5 },
        svg("title", {}, `${label(one)}: FLIP ${number(one.flip)} after ${seconds(one.seconds)}`))),
      svg("line", { class: "end", x1: x(end), x2: x(end), y1: TOP, y2: HEIGHT - BOTTOM }));
    const left = noise(all.at(-2));
    show($("trade-chart"),
      svg("svg", { width: WIDTH, height: HEIGHT, viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": "Error of the previews against time" }, parts),
      el("p", { class: "dim" }, `Each point is a preview, compared with the last picture, which was there after ${seconds(end)} (vertical line).`,
        left ? ` The noise that is left in the last picture is estimated as ${number(Number((100 * left).toPrecision(2)))} % of white (root mean square). Half of it costs about four times the samples.` : ""),
      el("details", {}, el("summary", {}, "Numbers"), el("table", {}, row("th", ["picture", "after", "mean FLIP", "PSNR (dB)"]),
        all.map((one) => row("td", [label(one), seconds(one.seconds), one.flip === 0 ? "0" : number(one.flip), Number.isFinite(one.psnr) ? number(Number(one.psnr.toPrecision(4))) : "equal"])))));
  }

  const row = (tag, cells) => el("tr", {}, cells.map((cell) => el(tag, {}, cell)));

  // ---- presets, and what was left out

  async function tables() {
    const { knobs, presets, left_out: skips } = await json("/trade");
    const apply = (name, write) => el("button", {
      type: "button", disabled: page.view.confined && write, title: write ? `Writes the values of \`${name}\` into the text; one undo takes them back` : `Runs with the values of \`${name}\` without changing the text`,
      onclick: () => page.attempt(() => (write ? edits.change("/preset", { preset: name, write }) : post("/preset", { digest: edits.seen(), preset: name, write }))),
    }, write ? "Write" : "Try");
    // A number with four digits; the title has all of them.
    const short = (text) => (/^[-+\d.e]+$/.test(text) && text.length > 8 ? number(Number(Number(text).toPrecision(4))) : text);
    const differs = (knob, level) => level !== null && level !== knob.value;
    const time = ({ forecast: { open, seconds: s, untimed } }) => (open === 0 ? "all cached" : `${s > 0 ? `about ${seconds(s)}` : ""}${untimed ? `${s > 0 ? " and " : ""}${untimed} ${untimed > 1 ? "nodes" : "node"} never timed` : ""}`);
    const tried = page.state.history.tried?.length;
    show($("trade-presets"),
      tried ? el("p", { class: "warning" }, `Values of ${tried} ${tried > 1 ? "parameters are" : "parameter is"} tried without being in the text. `,
        el("button", { type: "button", id: "trade-back", onclick: () => edits.revert() }, "Back to the text")) : null,
      knobs.length ? el("div", { class: "wide" }, el("table", {},
        el("tr", {}, el("th", {}, "parameter"), el("th", {}, "now"), presets.map((one) => el("th", {}, one.name))),
        knobs.map((knob) => el("tr", {},
          el("th", { class: "name" }, el("button", { type: "button", class: "plain", title: `Show \`${knob.node}\``, onclick: () => page.open(knob.node) }, `${knob.node}.${knob.parameter}`)),
          el("td", { title: knob.value }, knob.varies ? "varies" : short(knob.value)),
          knob.levels.map((level) => el("td", { class: differs(knob, level) ? "other" : "same" }, level === null ? "varies" : short(level))))),
        el("tr", {}, el("th", { class: "name" }, "run"), el("td", {}), presets.map((one) => el("td", {}, time(one)))),
        el("tr", {}, el("th", {}), el("td", {}), presets.map((one) => el("td", {}, apply(one.name, false), " ", apply(one.name, true))))))
        : el("p", { class: "dim" }, "This graph has no parameters that trade time for accuracy."));
    const verdict = (skip) => (skip.left_out === null ? "not checked" : skip.left_out ? "left out" : "computed");
    show($("trade-skips"), el("div", { class: "wide" }, el("table", {}, row("th", ["work", "", "result of the check", "to force it"]),
      skips.filter((skip) => skip.left_out !== null).map((skip) => el("tr", { title: `Left out if: ${skip.check}` }, el("td", {}, skip.what, skip.nodes.length ? el("div", { class: "dim" }, skip.nodes.join(", ")) : null),
        el("td", { class: skip.left_out ? "good" : "" }, verdict(skip)), el("td", {}, skip.found), el("td", { class: "dim" }, skip.force.replaceAll("`", "")))))),
    el("p", { class: "dim" }, `Not checked, since no node of this graph does such work: ${skips.filter((skip) => skip.left_out === null).map((skip) => skip.what).join("; ") || "nothing"}.`));
    await decisions();
  }

  // What the nodes decided, from their reports, and their warnings.
  async function decisions() {
    const found = [];
    for (const [id, node] of Object.entries(page.state.nodes)) {
      for (const out of (node.outputs ?? []).filter((one) => one.type === "report")) {
        try {
          const table = (await json(`/value/${out.digest}`)).report?.tables.find((one) => one.name === "decisions");
          if (table?.rows.length) found.push([id, table.rows]);
        } catch { /* the report is gone */ }
      }
    }
    const warnings = Object.entries(page.state.nodes).flatMap(([id, node]) => (node.notes ?? []).filter((note) => ["warning", "degraded"].includes(note.level)).map((note) => [id, note.text]));
    const text = (cell) => (Number.isInteger(cell) ? cell.toLocaleString("en") : typeof cell === "number" ? number(cell) : cell === null ? "not computed" : String(cell));
    show($("trade-model"),
      found.map(([id, rows]) => [el("h4", {}, id), el("div", { class: "wide" }, el("table", {}, rows.map((cells) => row("td", cells.map(text)))))]).flat(),
      found.length ? null : el("p", { class: "dim" }, "No node has reported decisions yet."),
      warnings.length ? [el("h4", {}, "Warnings"), el("ul", { class: "list" }, warnings.map(([id, words]) => el("li", { class: "warning" }, el("button", { type: "button", class: "plain", onclick: () => page.open(id) }, id), ` ${words}`)))] : null);
  }

  return { changed, open: () => { shown = ""; update(); } };
}
