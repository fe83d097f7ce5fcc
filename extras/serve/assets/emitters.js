// Marks on a panorama: the lights that `FuseHdr` has recovered, from its report.
import { $, number, svg } from "./dom.js";
import { json } from "./server.js";

const [AZIMUTH, ELEVATION, SIZE, BEFORE, AFTER, PEAK] = [0, 1, 2, 3, 4, 5];
// Lights with less than the first share of all light are not marked, and those with less than the second have no label.
const [MARKED, LABELLED] = [0.002, 0.02];

export function Emitters(page, outputs, picture) {
  let lights = [];
  let sum = 1;
  let digest = null;

  // The `FuseHdr` that made the shown panorama, or that reads it.
  function source() {
    const { nodes, wires } = page.view;
    const at = nodes?.indexOf(outputs.nodeOf(outputs.output())) ?? -1;
    if (at < 0) return null;
    const fuses = (index) => nodes[index].kind === "FuseHdr";
    if (fuses(at)) return nodes[at];
    const below = wires.find(([from, , to]) => from === at && fuses(to));
    if (below) return nodes[below[2]];
    const two = wires.filter(([from]) => from === at).map(([, , to]) => wires.find(([from, , to2]) => from === to && fuses(to2))).find(Boolean);
    return two ? nodes[two[2]] : null;
  }

  // Called when the picture changed.
  async function update() {
    const node = picture.isRound() ? source() : null;
    const found = page.state.nodes[node?.id]?.outputs.find((out) => out.type === "report")?.digest ?? null;
    $("lights-label").hidden = !found;
    if (found === digest) return;
    [digest, lights] = [found, []];
    if (!found) return draw();
    try {
      const table = (await json(`/value/${found}`)).report?.tables.find((one) => one.name === "emitters");
      if (digest !== found) return null;
      const rows = (table?.rows ?? []).filter((row) => typeof row[AZIMUTH] === "number" && typeof row[ELEVATION] === "number");
      sum = rows.reduce((all, row) => all + row[AFTER], 0) || 1;
      lights = rows.filter((row) => row[AFTER] >= MARKED * sum);
    } catch { digest = null; }
    return draw();
  }

  const share = (row) => `${number(Number(((100 * row[AFTER]) / sum).toPrecision(2)))} %`;

  // Called after each drawing of the picture.
  function draw() {
    const marks = $("marks");
    const a = picture.side("a");
    const shown = picture.isRound() && $("lights").checked && lights.length > 0;
    marks.toggleAttribute("hidden", !shown);
    if (!shown) return;
    const [circles, labels] = [[], []];
    lights.forEach((row, index) => {
      const x = ((((0.5 + row[AZIMUTH] / 360) * a.width) % a.width) + a.width) % a.width;
      const y = (0.5 - row[ELEVATION] / 180) * a.height;
      const at = picture.project(x, y);
      if (!at) return;
      // The circle has the solid angle of the light.
      const edge = picture.project(x, y - (Math.sqrt(row[SIZE] / Math.PI) / Math.PI) * a.height);
      const r = Math.max(6, edge ? Math.hypot(edge[0] - at[0], edge[1] - at[1]) : 6);
      const degrees = (v) => `${number(Number(v.toFixed(1)))}°`;
      const about = `light ${index + 1}, ${share(row)} of the light of all lights: irradiance on a plane that faces it ${number(row[AFTER])} (${number(row[BEFORE])} as captured), peak ${number(row[PEAK])}, ${number(row[SIZE])} sr, azimuth ${degrees(row[AZIMUTH])}, elevation ${degrees(row[ELEVATION])}`;
      const place = { cx: at[0], cy: at[1], r };
      circles.push(svg("circle", { ...place, class: "edge" }), svg("circle", place, svg("title", {}, about)));
      if (row[AFTER] < LABELLED * sum) return;
      // In the circle if there is room, else next to it.
      labels.push(r > 18 ? svg("text", { x: at[0], y: at[1] + 5, "text-anchor": "middle" }, share(row)) : svg("text", { x: at[0] + r * 0.75 + 4, y: at[1] - r * 0.75 - 2 }, share(row)));
    });
    marks.replaceChildren(...circles, ...labels);
  }

  $("lights").addEventListener("change", draw);
  return { update, draw };
}
