// Vectors, the camera of the place view, and packed values.

export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const mul = (a, k) => [a[0] * k, a[1] * k, a[2] * k];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const length = (a) => Math.hypot(...a);
export const unit = (a) => mul(a, 1 / (length(a) || 1));
export const distance = (a, b) => length(sub(a, b));

// Rotates a vector about a unit axis, counter-clockwise seen from the tip of the axis.
export function turned(v, axis, radians) {
  const [s, c] = [Math.sin(radians), Math.cos(radians)];
  return add(add(mul(v, c), mul(cross(axis, v), s)), mul(axis, dot(axis, v) * (1 - c)));
}

// Matrices have 16 numbers, column by column.
export const point = (m, p) => [0, 1, 2].map((i) => m[i] * p[0] + m[4 + i] * p[1] + m[8 + i] * p[2] + m[12 + i]);
export const column = (m, i) => [m[4 * i], m[4 * i + 1], m[4 * i + 2]];

// The affine transform `m`, followed by a turn by `radians` about `axis` and a scale by `k`, both about `centre`, and a
// translation by `way`.
export function moved(m, centre, { radians = 0, axis = [0, 0, 1], k = 1, way = [0, 0, 0] }) {
  const apply = (v) => mul(turned(v, axis, radians), k);
  const place = add(add(apply(sub(column(m, 3), centre)), centre), way);
  return [0, 1, 2].flatMap((i) => [...apply(column(m, i)), 0]).concat(place, 1);
}

// Where the ray from `eye` along `way` enters the box from `low` to `high` in the frame of `m`; Infinity if it does not.
export function boxHit(m, low, high, eye, way) {
  // The inverse of an affine transform, by cofactors.
  const [x, y, z, t] = [0, 1, 2, 3].map((i) => column(m, i));
  const volume = dot(x, cross(y, z));
  const rows = [cross(y, z), cross(z, x), cross(x, y)].map((row) => mul(row, 1 / volume));
  const [e, w] = [sub(eye, t), way].map((v) => rows.map((row) => dot(row, v)));
  let [near, far] = [0, Infinity];
  for (let i = 0; i < 3; i += 1) {
    const [a, b] = [(low[i] - e[i]) / w[i], (high[i] - e[i]) / w[i]].sort((p, q) => p - q);
    [near, far] = [Math.max(near, a), Math.min(far, b)];
  }
  return near <= far ? near : Infinity;
}

// An upright view: `eye`, the point `target` that is looked at, and a lens in pixels of the pane.
export class View {
  constructor(frame) {
    this.frame = frame;
    this.eye = [0, 0, 0];
    this.target = frame.forward;
    // A camera that is looked through, with its own axes until the view is moved.
    this.camera = null;
    this.exact = false;
    this.fov = 50;
    this.size = [1, 1];
  }

  // Right, down and forward.
  axes() {
    if (this.exact) return [0, 1, 2].map((i) => column(this.camera.matrix, i));
    const forward = unit(sub(this.target, this.eye));
    const right = unit(cross(forward, this.frame.up));
    return [right, cross(forward, right), forward];
  }

  // The rectangle of the picture of the camera in the pane: left, top, width, height.
  rectangle() {
    const [width, height] = this.size;
    if (!this.camera) return [0, 0, width, height];
    const k = Math.min(width / this.camera.width, height / this.camera.height);
    const [w, h] = [this.camera.width * k, this.camera.height * k];
    return [(width - w) / 2, (height - h) / 2, w, h];
  }

  lens() {
    const [width, height] = this.size;
    if (!this.camera) {
      const f = height / 2 / Math.tan((this.fov * Math.PI) / 360);
      return { fx: f, fy: f, cx: width / 2, cy: height / 2 };
    }
    const [left, top, w] = this.rectangle();
    const k = w / this.camera.width;
    return { fx: this.camera.fx * k, fy: this.camera.fy * k, cx: left + this.camera.cx * k, cy: top + this.camera.cy * k };
  }

  // A point in the pane and its depth; null behind the eye.
  project(p) {
    const [right, down, forward] = this.axes();
    const d = sub(p, this.eye);
    const z = dot(d, forward);
    if (z <= 1e-9 * length(d)) return null;
    const { fx, fy, cx, cy } = this.lens();
    return [cx + (fx * dot(d, right)) / z, cy + (fy * dot(d, down)) / z, z];
  }

  // The direction through a point of the pane.
  ray(x, y) {
    const [right, down, forward] = this.axes();
    const { fx, fy, cx, cy } = this.lens();
    return unit(add(add(mul(right, (x - cx) / fx), mul(down, (y - cy) / fy)), forward));
  }

  // The camera keeps its lens when the view moves, and becomes upright.
  free() {
    if (!this.exact) return;
    const forward = column(this.camera.matrix, 2);
    this.target = add(this.eye, mul(forward, this.reach));
    this.exact = false;
  }

  through(camera, reach) {
    this.camera = camera;
    this.reach = reach;
    if (!camera) return;
    this.exact = true;
    this.eye = column(camera.matrix, 3);
    this.target = add(this.eye, mul(column(camera.matrix, 2), reach));
  }

  orbit(dx, dy) {
    this.free();
    const { up } = this.frame;
    let back = sub(this.eye, this.target);
    back = turned(back, up, -dx);
    const right = unit(cross(up, back));
    const tilt = Math.acos(Math.max(-1, Math.min(1, dot(unit(back), up))));
    // Not over the poles, where upright has no meaning.
    back = turned(back, right, Math.max(0.03 - tilt, Math.min(Math.PI - 0.03 - tilt, -dy)));
    this.eye = add(this.target, back);
  }

  pan(dx, dy) {
    this.free();
    const [right, down] = this.axes();
    const way = add(mul(right, -dx), mul(down, -dy));
    [this.eye, this.target] = [add(this.eye, way), add(this.target, way)];
  }

  dolly(factor) {
    this.free();
    this.eye = add(this.target, mul(sub(this.eye, this.target), factor));
  }

  fly(x, y, z) {
    this.free();
    const [right, , forward] = this.axes();
    const way = add(add(mul(right, x), mul(this.frame.up, y)), mul(forward, z));
    [this.eye, this.target] = [add(this.eye, way), add(this.target, way)];
  }
}

// Reads a packed value: the description, and a reader of its arrays.
export function unpacked(buffer) {
  const size = new DataView(buffer).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size)));
  let at = 4 + size;
  const read = (Type, count) => {
    const array = new Type(buffer, at, count);
    at += array.byteLength;
    return array;
  };
  return { head, read };
}

// The order of every `stride`th splat from back to front for a direction: a counting sort of 16-bit depths. Returns their
// number.
export function backToFront(data, all, forward, order, stride) {
  const count = Math.ceil(all / stride);
  const depths = new Float32Array(count);
  let [low, high] = [Infinity, -Infinity];
  for (let i = 0; i < count; i += 1) {
    const at = 8 * i * stride;
    const depth = data[at] * forward[0] + data[at + 1] * forward[1] + data[at + 2] * forward[2];
    depths[i] = depth;
    if (depth < low) low = depth;
    if (depth > high) high = depth;
  }
  const bins = 65536;
  const scale = (bins - 1) / (high - low || 1);
  const starts = new Uint32Array(bins + 1);
  const keys = new Uint16Array(count);
  for (let i = 0; i < count; i += 1) {
    keys[i] = bins - 1 - ((depths[i] - low) * scale | 0);
    starts[keys[i] + 1] += 1;
  }
  for (let i = 0; i < bins; i += 1) starts[i + 1] += starts[i];
  for (let i = 0; i < count; i += 1) order[starts[keys[i]]++] = i * stride;
  return count;
}
