// Lines over the place view, in two dimensions: the gizmo of an object, cameras, probes; and what is under the pointer.
import { large } from "./dom.js";
import { add, column, cross, distance, dot, mul, sub, unit } from "./space.js";

const COLOURS = { right: "#e0564f", forward: "#57b05a", up: "#4f8fe8", ring: "#e6b93c", scale: "#d8d8d4", dim: "#c9ccd2", chosen: "#6fb1ff", probe: "#e6b93c" };
// Lengths on the screen, in pixels.
const [ARROW, RING, BOX, NEAR] = [84, 60, 104, 9];
// Factor of lengths and letters on a large screen.
const LARGE = 1.5;

export const handles = (frame) => [["right", frame.right], ["forward", frame.forward], ["up", frame.up]];

function toSegment(p, a, b) {
  const [dx, dy] = [b[0] - a[0], b[1] - a[1]];
  const t = Math.max(0, Math.min(1, ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / (dx * dx + dy * dy || 1)));
  return Math.hypot(p[0] - a[0] - t * dx, p[1] - a[1] - t * dy);
}

export function Lines(canvas) {
  const pen = canvas.getContext("2d");
  let view = null;
  let k = 1;
  // Points on the screen by which the last drawing can be hit.
  let hits = [];

  function begin(next, ratio) {
    view = next;
    k = large() ? LARGE : 1;
    hits = [];
    const [width, height] = view.size.map((v) => Math.max(1, Math.round(v * ratio)));
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, ...view.size);
    pen.lineJoin = "round";
    pen.lineCap = "round";
  }

  // The cross at which keys aim.
  function aim(p) {
    if (!p) return;
    for (const [dx, dy] of [[12, 0], [0, 12]]) stroke([[p[0] - dx * k, p[1] - dy * k], [p[0] + dx * k, p[1] + dy * k]], "#fff", 1.5);
  }

  // A line with a dark edge, so that it is visible on any ground.
  function stroke(points, colour, width = 2, alpha = 1) {
    if (points.some((p) => !p)) return;
    const path = () => { pen.beginPath(); points.forEach((p, i) => (i ? pen.lineTo(p[0], p[1]) : pen.moveTo(p[0], p[1]))); };
    pen.globalAlpha = alpha * 0.55;
    path(); pen.strokeStyle = "#000"; pen.lineWidth = (width + 1.5) * k; pen.stroke();
    pen.globalAlpha = alpha;
    path(); pen.strokeStyle = colour; pen.lineWidth = width * k; pen.stroke();
    pen.globalAlpha = 1;
  }

  function fill(points, colour) {
    pen.beginPath();
    points.forEach((p, i) => (i ? pen.lineTo(p[0], p[1]) : pen.moveTo(p[0], p[1])));
    pen.closePath();
    pen.fillStyle = colour; pen.strokeStyle = "#0009"; pen.lineWidth = 1;
    pen.fill(); pen.stroke();
  }

  function text(words, x, y, colour = "#fff") {
    pen.font = `${12 * k}px system-ui, sans-serif`;
    pen.lineWidth = 3 * k; pen.strokeStyle = "#000b"; pen.fillStyle = colour;
    pen.strokeText(words, x, y); pen.fillText(words, x, y);
  }

  // What lies outside the picture of a camera is darker.
  function mask() {
    const [left, top, width, height] = view.rectangle();
    pen.fillStyle = "#0008";
    pen.beginPath();
    pen.rect(0, 0, ...view.size);
    pen.rect(left, top, width, height);
    pen.fill("evenodd");
    pen.strokeStyle = "#fff9"; pen.lineWidth = 1; pen.strokeRect(left + 0.5, top + 0.5, width - 1, height - 1);
  }

  function camera(one, index, reach, chosen) {
    const eye = column(one.matrix, 3);
    const at = (x, y) => add(eye, add(add(mul(column(one.matrix, 0), ((x - one.cx) / one.fx) * reach), mul(column(one.matrix, 1), ((y - one.cy) / one.fy) * reach)), mul(column(one.matrix, 2), reach)));
    const corners = [at(0, 0), at(one.width, 0), at(one.width, one.height), at(0, one.height)].map((p) => view.project(p));
    const tip = view.project(eye);
    const colour = chosen ? COLOURS.chosen : COLOURS.dim;
    stroke([...corners, corners[0]], colour, 1.2, 0.9);
    for (const corner of corners) stroke([tip, corner], colour, 1.2, 0.9);
    const above = view.project(add(at(one.width / 2, 0), mul(column(one.matrix, 1), -0.25 * reach)));
    if (corners[0] && corners[1] && above) stroke([corners[0], above, corners[1]], colour, 1.2, 0.9);
    if (!tip) return;
    hits.push({ kind: "camera", index, points: [tip, tip] });
    text(one.name, tip[0] + 7, tip[1] - 6, colour);
  }

  // A camera of a rig with many: a point, whose frustum and name are shown when the pointer is there.
  function spot(one, index) {
    const at = view.project(column(one.matrix, 3));
    if (!at) return;
    pen.beginPath(); pen.arc(at[0], at[1], 2.5, 0, 7); pen.fillStyle = COLOURS.dim; pen.fill(); pen.strokeStyle = "#000a"; pen.lineWidth = 1; pen.stroke();
    hits.push({ kind: "camera", index, points: [at, at] });
  }

  // An object that can be chosen: its name, and a point where it stands.
  function tag(name, index, foot) {
    const at = view.project(foot);
    if (!at) return;
    pen.beginPath(); pen.arc(at[0], at[1], 5, 0, 7); pen.fillStyle = "#fff8"; pen.fill(); pen.strokeStyle = "#000a"; pen.lineWidth = 1.5; pen.stroke();
    text(name, at[0] + 9, at[1] + 4);
    hits.push({ kind: "tag", index, points: [at, at] });
  }

  function probe(one, radius) {
    const centre = view.project(one.eye);
    if (!centre) return;
    const { fy } = view.lens();
    const r = Math.max(5, Math.min(40, (radius * fy) / centre[2]));
    pen.beginPath(); pen.arc(centre[0], centre[1], r, 0, 7); pen.fillStyle = "#e6b93c44"; pen.fill();
    pen.strokeStyle = "#000a"; pen.lineWidth = 3; pen.stroke(); pen.strokeStyle = COLOURS.probe; pen.lineWidth = 1.5; pen.stroke();
    pen.beginPath(); pen.ellipse(centre[0], centre[1], r, r * 0.35, 0, 0, 7); pen.stroke();
    text(one.node, centre[0] + r + 4, centre[1] + 4, COLOURS.probe);
  }

  const ringPoints = (centre, reach) => {
    const { right, forward } = view.frame;
    return Array.from({ length: 65 }, (_, i) => view.project(add(centre, add(mul(right, Math.cos((i * Math.PI) / 32) * reach), mul(forward, Math.sin((i * Math.PI) / 32) * reach)))));
  };

  // The gizmo at the origin of an object. `front` is the direction that the object faces.
  function gizmo(centre, front, hot) {
    const at = view.project(centre);
    if (!at) return;
    const world = (k * at[2]) / view.lens().fy;
    const ring = ringPoints(centre, RING * world);
    if (ring.every(Boolean)) {
      stroke(ring, COLOURS.ring, hot === "ring" ? 4 : 2.5);
      hits.push({ kind: "ring", points: ring });
      const nose = view.project(add(centre, mul(front, RING * 1.22 * world)));
      const edges = [-0.12, 0.12].map((angle) => view.project(add(centre, mul(add(front, mul(cross(view.frame.up, front), angle)), RING * 1.02 * world))));
      if (nose && edges.every(Boolean)) fill([nose, ...edges], COLOURS.ring);
    }
    const [right, down] = view.axes();
    for (const [name, axis] of handles(view.frame)) {
      const tip = view.project(add(centre, mul(axis, ARROW * world)));
      // An arrow that points at the eye cannot be dragged.
      if (!tip || Math.hypot(tip[0] - at[0], tip[1] - at[1]) < 14) continue;
      stroke([at, tip], COLOURS[name], hot === name ? 4.5 : 3);
      const [dx, dy] = [tip[0] - at[0], tip[1] - at[1]].map((v) => v / Math.hypot(tip[0] - at[0], tip[1] - at[1]));
      fill([[tip[0] + dx * 11, tip[1] + dy * 11], [tip[0] - dy * 5.5, tip[1] + dx * 5.5], [tip[0] + dy * 5.5, tip[1] - dx * 5.5]], COLOURS[name]);
      hits.push({ kind: name, points: [[at[0] + dx * 12, at[1] + dy * 12], [tip[0] + dx * 11, tip[1] + dy * 11]] });
    }
    const box = view.project(add(centre, mul(sub(right, down), (BOX / Math.SQRT2) * world)));
    if (box) {
      stroke([at, box], COLOURS.scale, 1, 0.5);
      const half = hot === "scale" ? 7 : 5.5;
      fill([[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([x, y]) => [box[0] + x * half, box[1] + y * half]), COLOURS.scale);
      hits.push({ kind: "scale", points: [box, box] });
    }
    pen.beginPath(); pen.arc(at[0], at[1], hot === "body" ? 7 : 5, 0, 7); pen.fillStyle = "#fff"; pen.fill(); pen.strokeStyle = "#000a"; pen.lineWidth = 1.5; pen.stroke();
  }

  // The contact with the ground: a circle around the foot, and the height above the ground.
  function contact(foot, ground, radius) {
    stroke(ringPoints(ground, radius), "#fff", 1, 0.7);
    if (distance(foot, ground) > 1e-6 * radius) stroke([view.project(foot), view.project(ground)], "#fff", 1, 0.7);
  }

  function mark(p) {
    const at = p && view.project(p);
    if (!at) return;
    pen.beginPath(); pen.arc(at[0], at[1], 4, 0, 7); pen.strokeStyle = "#000a"; pen.lineWidth = 3; pen.stroke(); pen.strokeStyle = "#fff"; pen.lineWidth = 1.5; pen.stroke();
  }

  // Measured points, and the distance between them in words.
  function ruler(points, words) {
    points.forEach(mark);
    const ends = points.map((p) => view.project(p));
    if (ends.length < 2 || !ends.every(Boolean)) return;
    stroke(ends, "#fff", 2);
    text(words, (ends[0][0] + ends[1][0]) / 2 + 8, (ends[0][1] + ends[1][1]) / 2 - 6);
  }

  // The axes of the world in the corner.
  function triad() {
    const [right, down] = view.axes();
    const at = [34, view.size[1] - 34];
    for (const [name, axis] of handles(view.frame)) {
      const tip = [at[0] + 22 * dot(axis, right), at[1] + 22 * dot(axis, down)];
      stroke([at, tip], COLOURS[name], 2);
      if (name === "up") text("up", tip[0] + 4, tip[1] - 3, COLOURS.up);
    }
  }

  // The nearest part of the gizmo, or camera, at a point; null if nothing is near.
  function hit(p) {
    let best = null;
    for (const one of hits) {
      let away = Infinity;
      for (let i = 1; i < one.points.length; i += 1) away = Math.min(away, toSegment(p, one.points[i - 1], one.points[i]));
      // Smaller parts come first.
      const rank = away - (one.kind === "scale" ? 3 : ["ring", "camera", "tag"].includes(one.kind) ? -2 : 0);
      if (away < NEAR * k && rank < (best?.rank ?? Infinity)) best = { ...one, rank };
    }
    return best;
  }

  return { begin, mask, aim, camera, spot, tag, probe, gizmo, contact, mark, ruler, triad, hit };
}

// The place along the line through `centre` in the direction `axis` that is nearest to a ray, as a length.
export function alongAxis(centre, axis, eye, way) {
  const between = sub(centre, eye);
  const [b, d, e] = [dot(axis, way), dot(axis, between), dot(way, between)];
  const determinant = 1 - b * b;
  return determinant < 1e-4 ? 0 : (b * e - d) / determinant;
}

// The place where a ray meets the plane through `centre` with the normal `up`; null if it does not.
export function onPlane(centre, up, eye, way) {
  const t = dot(sub(centre, eye), up) / dot(way, up);
  return t > 0 && Number.isFinite(t) ? add(eye, mul(unit(way), t)) : null;
}
