// The picture pane: two pictures, A and B, with zoom, read-out, exposure and comparison.
import { $, el, framed, number, show } from "./dom.js";
import { bytes, json } from "./server.js";
import { FRAGMENT, VERTEX } from "./shader.js";

const ENCODINGS = { linear: 0, srgb: 1, data: 2 };
const FORMATS = { f32: ["R32F", "RG32F", "RGB32F", "RGBA32F"], f16: ["R16F", "RG16F", "RGB16F", "RGBA16F"] };
// Pictures above this number of samples are sent as half floats.
const MOST_FLOATS = 1 << 24;

// A half float as a number.
export function half(bits) {
  const [sign, exponent, part] = [bits & 0x8000 ? -1 : 1, (bits >> 10) & 31, bits & 1023];
  if (exponent === 0) return sign * part * 2 ** -24;
  if (exponent === 31) return part ? NaN : sign * Infinity;
  return sign * (1 + part / 1024) * 2 ** (exponent - 15);
}

// `report(side, about, error)` is called when a picture is there, or cannot be loaded; `drawn` after each drawing.
export function Picture(report, drawn) {
  const [view, canvas] = [$("view"), $("canvas")];
  let gl = null;
  let program = null;
  let failure = null;
  const sides = { a: null, b: null };
  // FLIP of each pixel of the two sides.
  let flip = null;
  const state = { zoom: 1, pan: [0, 0], fitted: true, split: 0.5, mode: 0, sphere: null };
  const redraw = framed(draw);

  function start() {
    gl = canvas.getContext("webgl2", { alpha: true, antialias: false, preserveDrawingBuffer: true });
    if (!gl) { failure = "This browser has no WebGL 2, so pictures are shown without tone curve, comparison and read-out."; return; }
    program = gl.createProgram();
    for (const [type, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
      failure = `The graphics driver refuses the program of the page: ${gl.getProgramInfoLog(program)}`;
      gl = null;
    }
  }

  // Loads picture `index` of the value `digest` into side `a` or `b`; null empties the side. Keeps the last picture
  // until the new one is there.
  const wanted = { a: null, b: null };
  async function load(side, digest, index) {
    const want = digest ? `${digest}/${index}` : null;
    if (wanted[side] === want) return;
    wanted[side] = want;
    if (!want) { free(side); redraw(); return; }
    try {
      const about = await json(`/value/${digest}`);
      const picture = about.pictures[index] ?? about.pictures[0];
      if (wanted[side] !== want) return;
      if (!picture) { free(side); report(side, about, null); redraw(); return; }
      const number = about.pictures.indexOf(picture);
      const size = picture.width * picture.height * picture.channels;
      const form = size > MOST_FLOATS ? "f16" : "f32";
      const drawn = gl && Math.max(picture.width, picture.height) <= gl.getParameter(gl.MAX_TEXTURE_SIZE) && picture.channels <= 4;
      const data = drawn ? await bytes(`/value/${digest}/${number}.${form}`) : null;
      if (wanted[side] !== want) return;
      const before = sides[side];
      free(side);
      const samples = data && (form === "f32" ? new Float32Array(data) : new Uint16Array(data));
      sides[side] = { ...picture, digest, number, form, samples, texture: data && texture(picture, form, samples) };
      if (side === "a" && (!before || before.width !== picture.width || before.height !== picture.height) && state.fitted) fit();
      report(side, about, null);
    } catch (error) {
      if (wanted[side] !== want) return;
      wanted[side] = null;
      report(side, null, error);
    }
    redraw();
  }

  function texture({ width, height, channels }, form, samples) {
    const made = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, made);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    const outer = [gl.RED, gl.RG, gl.RGB, gl.RGBA][channels - 1];
    gl.texImage2D(gl.TEXTURE_2D, 0, gl[FORMATS[form][channels - 1]], width, height, 0, outer, form === "f32" ? gl.FLOAT : gl.HALF_FLOAT, samples);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    return made;
  }

  function free(side) {
    if (sides[side]?.texture) gl?.deleteTexture(sides[side].texture);
    sides[side] = null;
  }

  // A panorama, which can be looked at from inside.
  const isRound = () => Boolean(sides.a && sides.a.width === 2 * sides.a.height && sides.a.texture);
  const sphere = () => (isRound() ? state.sphere : null);

  function round() {
    if (!isRound()) return;
    state.sphere = state.sphere ? null : { yaw: 0, pitch: 0, fov: 75 };
    redraw();
  }

  const focal = () => view.clientHeight / 2 / Math.tan((state.sphere.fov * Math.PI) / 360);

  // The direction of a point of the pane, to the right and down for the distance 1 ahead.
  const aside = (x, y) => [(x - view.clientWidth / 2) / focal(), (y - view.clientHeight / 2) / focal()];

  // The direction in the panorama of a point of the pane: the angle about the vertical, and the part that points down.
  function direction(x, y) {
    const { yaw, pitch } = state.sphere;
    const [dx, dy] = aside(x, y);
    const [s, c] = [Math.sin(pitch), Math.cos(pitch)];
    return [Math.atan2(dx, dy * s + c) + yaw, (dy * c - s) / Math.hypot(dx, dy, 1)];
  }

  // Turns the sphere so that a direction is under a point of the pane.
  function turn([angle, down], x, y) {
    const [dx, dy] = aside(x, y);
    const pitch = Math.acos(Math.max(-1, Math.min(1, (down * Math.hypot(dx, dy, 1)) / Math.hypot(dy, 1)))) - Math.atan2(1, dy);
    state.sphere.pitch = Math.max(-1.55, Math.min(1.55, pitch));
    state.sphere.yaw = angle - Math.atan2(dx, dy * Math.sin(state.sphere.pitch) + Math.cos(state.sphere.pitch));
  }

  // The position in picture A of a point of the pane, in pixels.
  function spot(x, y) {
    const a = sides.a;
    if (!sphere()) return [(x - state.pan[0]) / state.zoom, (y - state.pan[1]) / state.zoom];
    const [angle, down] = direction(x, y);
    const u = 0.5 + angle / (2 * Math.PI);
    return [(u - Math.floor(u)) * a.width, (Math.acos(Math.max(-1, Math.min(1, -down))) / Math.PI) * a.height];
  }

  // Without its data, a comparison shows A.
  const mode = () => (!sides.b || (state.mode === 4 && !flip) ? 0 : state.mode);

  function draw() {
    const a = sides.a;
    $("sphere").hidden = !isRound();
    $("sphere").setAttribute("aria-pressed", String(Boolean(sphere())));
    $("empty").hidden = Boolean(a) || !$("report").hidden;
    const fallback = $("fallback");
    const plain = a && !a.texture;
    fallback.hidden = !plain;
    canvas.hidden = Boolean(plain) || !a;
    if (plain) fallback.src = `/value/${a.digest}/${a.number}.png?exposure=${$("exposure").value}`;
    $("split").hidden = mode() !== 1 || plain;
    $("split").style.left = `${state.split * 100}%`;
    $("label-a").hidden = !sides.b || mode() === 2 || mode() > 2;
    $("label-b").hidden = !sides.b || mode() === 0 || mode() > 2;
    drawn(a);
    readout();
    if (!gl || !a?.texture) return;
    const ratio = devicePixelRatio;
    const [width, height] = [Math.round(view.clientWidth * ratio), Math.round(view.clientHeight * ratio)];
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    gl.viewport(0, 0, width, height);
    gl.useProgram(program);
    const at = (name) => gl.getUniformLocation(program, name);
    const b = sides.b?.texture ? sides.b : a;
    for (const [unit, name, side] of [[0, "A", a], [1, "B", b]]) {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, side.texture);
      gl.uniform1i(at(name.toLowerCase()), unit);
      gl.uniform2i(at(`size${name}`), side.width, side.height);
      gl.uniform2i(at(`form${name}`), ENCODINGS[side.encoding], side.channels);
      gl.uniform2f(at(`range${name}`), side.low, side.high);
    }
    gl.uniform2f(at("view"), width, height);
    gl.uniform2f(at("pan"), state.pan[0] * ratio, state.pan[1] * ratio);
    gl.uniform1f(at("zoom"), state.zoom * ratio);
    gl.activeTexture(gl.TEXTURE2);
    gl.bindTexture(gl.TEXTURE_2D, flip?.texture ?? a.texture);
    gl.uniform1i(at("flip"), 2);
    const ball = sphere();
    gl.uniform4f(at("sphere"), ball?.yaw ?? 0, ball?.pitch ?? 0, ball ? focal() * ratio : 1, ball ? 1 : 0);
    gl.uniform1f(at("exposure"), Number($("exposure").value));
    gl.uniform1f(at("split"), state.split * width);
    gl.uniform1i(at("mode"), mode());
    gl.uniform1i(at("curve"), Number($("curve").value));
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  function fit() {
    const a = sides.a;
    if (!a) return;
    state.fitted = true;
    state.zoom = Math.min(view.clientWidth / a.width, view.clientHeight / a.height) || 1;
    state.pan = [(view.clientWidth - a.width * state.zoom) / 2, (view.clientHeight - a.height * state.zoom) / 2];
    redraw();
  }

  function zoom(factor, x = view.clientWidth / 2, y = view.clientHeight / 2) {
    if (sphere()) { state.sphere.fov = Math.min(130, Math.max(2, state.sphere.fov / factor)); redraw(); return; }
    const next = Math.min(256, Math.max(0.02, state.zoom * factor));
    state.pan = [x - ((x - state.pan[0]) * next) / state.zoom, y - ((y - state.pan[1]) * next) / state.zoom];
    [state.zoom, state.fitted] = [next, false];
    redraw();
  }

  const whole = () => zoom(1 / devicePixelRatio / state.zoom);

  // The samples of a side at a point of A, as text.
  function sample(side, u, v) {
    const one = sides[side];
    if (!one?.samples) return "";
    const [x, y] = [Math.floor(u * one.width), Math.floor(v * one.height)];
    const start = (y * one.width + x) * one.channels;
    const values = Array.from(one.samples.subarray(start, start + one.channels), (s) => number(one.form === "f16" ? half(s) : s));
    return `${side.toUpperCase()} ${values.join("  ")}`;
  }

  // Where the pointer is on the screen; null outside of the pane.
  let pointed = null;
  function readout() {
    const a = sides.a;
    if (!a || !pointed) { $("pixel").textContent = ""; return; }
    const box = view.getBoundingClientRect();
    const [x, y] = spot(pointed[0] - box.left, pointed[1] - box.top);
    const inside = x >= 0 && y >= 0 && x < a.width && y < a.height;
    const [u, v] = [x / a.width, y / a.height];
    const differs = inside && flip ? `FLIP ${number(flip.samples[Math.floor(y) * flip.width + Math.floor(x)])}` : "";
    $("pixel").textContent = inside ? [`(${Math.floor(x)}, ${Math.floor(y)})`, sample("a", u, v), sample("b", u, v), differs].filter(Boolean).join("   ") : "";
  }

  // What is shown moves by a part of the pane.
  function pan(right, down) {
    if (sphere()) {
      state.sphere.yaw += right * 0.1;
      state.sphere.pitch = Math.max(-1.55, Math.min(1.55, state.sphere.pitch - down * 0.1));
    } else {
      state.pan = [state.pan[0] - right * 40, state.pan[1] - down * 40];
      state.fitted = false;
    }
    redraw();
  }

  function slide(split) {
    state.split = Math.min(1, Math.max(0, split));
    $("split").setAttribute("aria-valuenow", String(Math.round(100 * state.split)));
    redraw();
  }

  view.addEventListener("keydown", (event) => {
    const [right, down] = { ArrowRight: [1, 0], ArrowLeft: [-1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key] ?? [0, 0];
    const by = event.shiftKey ? 5 : 1;
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("#report")) return;
    if (event.target === $("split") && (right || ["Home", "End"].includes(event.key))) slide({ Home: 0, End: 1 }[event.key] ?? state.split + 0.02 * right * by);
    else if (right || down) pan(right * by, down * by);
    else return;
    event.preventDefault();
    event.stopPropagation();
  });

  let drag = null;
  view.addEventListener("pointerdown", (event) => {
    if (event.target.closest("#report")) return;
    const box = view.getBoundingClientRect();
    const grabbed = sphere() && direction(event.clientX - box.left, event.clientY - box.top);
    drag = { split: event.target === $("split"), x: event.clientX, y: event.clientY, pan: [...state.pan], grabbed };
    view.setPointerCapture(event.pointerId);
  });
  view.addEventListener("pointermove", (event) => {
    pointed = [event.clientX, event.clientY];
    readout();
    if (!drag) return;
    const box = view.getBoundingClientRect();
    if (drag.split) {
      slide((event.clientX - box.left) / box.width);
    } else if (sphere() && drag.grabbed) {
      // What is under the pointer follows it.
      turn(drag.grabbed, event.clientX - box.left, event.clientY - box.top);
    } else {
      state.pan = [drag.pan[0] + event.clientX - drag.x, drag.pan[1] + event.clientY - drag.y];
      state.fitted = false;
    }
    redraw();
  });
  view.addEventListener("pointerleave", () => { pointed = null; readout(); });
  for (const end of ["pointerup", "pointercancel"]) view.addEventListener(end, () => { drag = null; });
  view.addEventListener("wheel", (event) => {
    if (event.target.closest("#report")) return;
    event.preventDefault();
    const box = view.getBoundingClientRect();
    zoom(2 ** (-event.deltaY / (event.deltaMode ? 6 : 240)), event.clientX - box.left, event.clientY - box.top);
  }, { passive: false });
  $("exposure").addEventListener("input", () => { $("exposure-value").value = Number($("exposure").value).toFixed(1); redraw(); });
  $("curve").addEventListener("input", redraw);
  $("mode").addEventListener("input", () => { state.mode = Number($("mode").value); redraw(); });
  $("fit").addEventListener("click", fit);
  $("whole").addEventListener("click", whole);
  $("sphere").addEventListener("click", round);
  canvas.addEventListener("webglcontextlost", (event) => { event.preventDefault(); });
  canvas.addEventListener("webglcontextrestored", () => {
    start();
    if (flip && gl) flip.texture = texture(flip, "f32", flip.samples);
    for (const side of ["a", "b"]) if (sides[side]?.samples && gl) sides[side].texture = texture(sides[side], sides[side].form, sides[side].samples);
    redraw();
  });
  new ResizeObserver(() => { if (state.fitted) fit(); redraw(); }).observe(view);
  start();

  function set(mode) {
    state.mode = mode;
    $("mode").value = String(mode);
    redraw();
  }

  // Sets FLIP of each pixel of A against B; null removes it.
  function differ(next) {
    if (flip?.texture) gl?.deleteTexture(flip.texture);
    flip = next && gl ? { ...next, channels: 1, texture: texture({ ...next, channels: 1 }, "f32", next.samples) } : null;
    redraw();
  }

  // The position in the pane of a point of picture A; null if it is not visible.
  function project(x, y) {
    if (!sphere()) return [x * state.zoom + state.pan[0], y * state.zoom + state.pan[1]];
    const [yaw, polar] = [((x / sides.a.width) - 0.5) * 2 * Math.PI - state.sphere.yaw, (y / sides.a.height) * Math.PI];
    const [right, down, ahead] = [Math.sin(polar) * Math.sin(yaw), -Math.cos(polar), Math.sin(polar) * Math.cos(yaw)];
    const [s, c] = [Math.sin(state.sphere.pitch), Math.cos(state.sphere.pitch)];
    const [low, depth] = [down * c + ahead * s, ahead * c - down * s];
    return depth > 0.05 ? [view.clientWidth / 2 + (right / depth) * focal(), view.clientHeight / 2 + (low / depth) * focal()] : null;
  }

  // The tables of a report in place of the picture; null for a picture.
  function tables(value) {
    $("report").hidden = !value;
    if (value) {
      const row = (cells, tag) => el("tr", {}, cells.map((cell) => el(tag, {}, typeof cell === "number" ? number(cell) : cell === null ? "not computed" : String(cell))));
      show($("report"), el("h3", {}, value.title), value.tables.map((table) => [
        el("h3", {}, table.name), el("table", {}, row(table.columns, "th"), table.rows.map((cells) => row(cells, "td")))]).flat());
    }
    redraw();
  }

  return { load, fit, whole, round, zoom, set, tables, redraw, mode: () => state.mode, side: (name) => sides[name], differ, project, isRound, failure: () => failure };
}
