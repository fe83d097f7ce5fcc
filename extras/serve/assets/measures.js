// The difference between the pictures A and B in numbers, and FLIP of each pixel.
import { $, number } from "./dom.js";
import { bytes, json } from "./server.js";

// Larger pictures are compared only if FLIP is asked for.
const SOON = 1 << 21;
const COLUMNS = [["flip mean", "FLIP"], ["flip p95", "95 %"], ["psnr", "PSNR", "dB"], ["ssim_3dgs_zero_pad", "SSIM"], ["ciede2000 mean", "CIEDE2000"], ["mean absolute error", "mean error"]];

export function Measures(page, picture) {
  let wanted = null;
  let busy = false;

  // Called when one of the pictures or the mode changed. Small pictures are compared when the run has ended.
  function update() {
    const [a, b] = [picture.side("a"), picture.side("b")];
    const asked = picture.mode() === 4;
    const path = a && b ? `/difference/${a.digest}/${a.number}/${b.digest}/${b.number}` : null;
    if (path !== wanted) {
      wanted = null;
      picture.differ(null);
      $("measures").textContent = "";
    }
    $("measures").hidden = !path;
    if (!path || path === wanted || busy) return;
    if (!asked && (page.state.running || a.width * a.height > SOON)) return;
    wanted = path;
    load(path);
  }

  async function load(path) {
    busy = true;
    const [a, b] = [picture.side("a"), picture.side("b")];
    $("measures").textContent = "comparing A with B ..";
    try {
      const found = await json(path);
      const map = found.flip ? new Float32Array(await bytes(`${path}/flip.f32`)) : null;
      if (wanted === path && a === picture.side("a") && b === picture.side("b")) {
        if (map) picture.differ({ width: found.flip[0], height: found.flip[1], samples: map });
        $("measures").textContent = words(found);
      }
    } catch (error) {
      if (wanted === path) $("measures").textContent = error.message;
    }
    busy = false;
    update();
  }

  function words({ report, notes }) {
    const table = report.tables[0];
    const row = table?.rows[0];
    if (!row) return notes.join("; ");
    const cell = (name) => row[table.columns.findIndex((column) => column === name || column.startsWith(`${name} (`))];
    const text = ([name, label, unit]) => {
      const value = cell(name);
      if (typeof value !== "number") return value === null || value === undefined ? null : `${label} ${value}`;
      return `${label} ${number(Number(value.toPrecision(3)))}${unit ? ` ${unit}` : ""}`;
    };
    return `A against B: ${COLUMNS.map(text).filter(Boolean).join(" · ")}`;
  }

  return { update };
}
