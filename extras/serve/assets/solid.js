// The renderer of the place view: splats from back to front, and meshes, in WebGL 2. The camera is the origin, so that
// scenes far from the origin of the world keep their detail.
import { backToFront, column, dot, sub } from "./space.js";

// The projection and the constants are those of `SplatRender`: Zwicker et al. 2001, and the INRIA rasterizer.
const SPLAT_VERTEX = `#version 300 es
precision highp float;
precision highp usampler2D;
uniform usampler2D splats;
uniform mat3 view;
uniform vec3 offset;
uniform vec4 lens;
uniform vec2 size, range;
uniform float near, cut, larger;
uniform vec3 up;
in uint index;
out vec2 place;
flat out vec4 colour;
void main() {
  ivec2 at = ivec2((index & 511u) * 2u, index >> 9);
  uvec4 a = texelFetch(splats, at, 0), b = texelFetch(splats, at + ivec2(1, 0), 0);
  vec3 p = view * (uintBitsToFloat(a.xyz) + offset);
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
  colour = vec4(a.w & 255u, (a.w >> 8) & 255u, (a.w >> 16) & 255u, a.w >> 24) / 255.0;
  if (p.z <= near || dot(uintBitsToFloat(a.xyz) + offset, up) > cut || colour.a < 1.0 / 255.0) return;
  vec2 xx = unpackHalf2x16(b.y), xz = unpackHalf2x16(b.z), zz = unpackHalf2x16(b.w);
  mat3 spread = mat3(xx.x, xx.y, xz.x, xx.y, xz.y, zz.x, xz.x, zz.x, zz.y);
  vec2 low = (-0.15 * size - lens.zw) / lens.xy, high = (1.15 * size - lens.zw) / lens.xy;
  vec2 t = clamp(p.xy / p.z, low, high);
  // The covariance is computed for the distance 1, since squares of small lengths underflow.
  mat3 turned = view * spread * transpose(view);
  vec3 row0 = vec3(lens.x, 0.0, -lens.x * t.x), row1 = vec3(0.0, lens.y, -lens.y * t.y);
  float k = uintBitsToFloat(b.x) * larger / (p.z * p.z);
  float cxx = dot(row0, turned * row0) * k + 0.3, cxy = dot(row0, turned * row1) * k, cyy = dot(row1, turned * row1) * k + 0.3;
  float middle = 0.5 * (cxx + cyy), half_gap = length(vec2(0.5 * (cxx - cyy), cxy));
  float large = middle + half_gap, small = max(middle - half_gap, 0.01);
  vec2 axis = abs(cxy) > 1e-6 * large ? normalize(vec2(cxy, large - cxx)) : cxx >= cyy ? vec2(1.0, 0.0) : vec2(0.0, 1.0);
  float reach = sqrt(2.0 * log(255.0 * colour.a));
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  place = corner * reach;
  vec2 middle_px = lens.xy * p.xy / p.z + lens.zw;
  vec2 px = middle_px + place.x * sqrt(large) * axis + place.y * sqrt(small) * vec2(-axis.y, axis.x);
  vec2 ndc = px / size * 2.0 - 1.0;
  float depth = (range.y + range.x) / (range.y - range.x) - 2.0 * range.y * range.x / ((range.y - range.x) * p.z);
  gl_Position = vec4(ndc.x, -ndc.y, min(depth, 1.0), 1.0);
}`;

const SPLAT_FRAGMENT = `#version 300 es
precision highp float;
in vec2 place;
flat in vec4 colour;
out vec4 result;
void main() {
  float alpha = min(0.99, colour.a * exp(-0.5 * dot(place, place)));
  if (alpha < 1.0 / 255.0) discard;
  result = vec4(colour.rgb * alpha, alpha);
}`;

const MESH_VERTEX = `#version 300 es
precision highp float;
uniform mat3 view, linear;
uniform vec3 offset;
uniform vec4 lens;
uniform vec2 size, range;
uniform vec3 above;
in vec3 position, normal;
in vec4 colour;
out vec3 at, facing;
out float height;
out vec4 tint;
void main() {
  vec3 world = linear * position + offset, p = view * world;
  at = p;
  height = dot(world, above);
  facing = view * (linear * normal);
  tint = colour;
  vec2 scale = 2.0 * lens.xy / size, shift = 2.0 * lens.zw / size - 1.0;
  float depth = (range.y + range.x) / (range.y - range.x) * p.z - 2.0 * range.y * range.x / (range.y - range.x);
  gl_Position = vec4(scale.x * p.x + shift.x * p.z, -(scale.y * p.y + shift.y * p.z), depth, p.z);
}`;

const MESH_FRAGMENT = `#version 300 es
precision highp float;
uniform bool flat_shaded;
uniform vec4 mixed;
uniform float opacity, cut;
uniform vec3 up;
in vec3 at, facing;
in float height;
in vec4 tint;
out vec4 result;
void main() {
  if (height > cut) discard;
  vec3 n = normalize(flat_shaded ? cross(dFdx(at), dFdy(at)) : facing);
  vec3 way = normalize(-at);
  n = dot(n, way) < 0.0 ? -n : n;
  // Light from above, and from the eye.
  float light = 0.42 + 0.22 * dot(n, up) + 0.42 * pow(max(dot(n, way), 0.0), 1.5);
  vec3 rgb = mix(tint.rgb, mixed.rgb, mixed.a) * light;
  result = vec4(rgb, 1.0) * opacity;
}`;

const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

// True if WebGL is computed on the CPU.
function inSoftware() {
  const gl = document.createElement("canvas").getContext("webgl2");
  const info = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software/i.test(name);
}

export function Solid(canvas) {
  const software = inSoftware();
  const gl = canvas.getContext("webgl2", { alpha: true, antialias: !software, preserveDrawingBuffer: true, premultipliedAlpha: true });
  if (!gl) return { failure: "This browser has no WebGL 2, which the view of the place needs." };
  let failure = null;

  function program(vertex, fragment) {
    const made = gl.createProgram();
    for (const [type, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(type);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) failure = `The graphics driver refuses a shader of the page: ${gl.getShaderInfoLog(shader)}`;
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS)) failure ??= `The graphics driver refuses a program of the page: ${gl.getProgramInfoLog(made)}`;
    const places = {};
    return { made, at: (name) => (places[name] ??= gl.getUniformLocation(made, name)), attribute: (name) => gl.getAttribLocation(made, name) };
  }

  let splatProgram = null;
  let meshProgram = null;
  let cloud = null;
  const meshes = new Map();

  function start() {
    splatProgram = program(SPLAT_VERTEX, SPLAT_FRAGMENT);
    meshProgram = program(MESH_VERTEX, MESH_FRAGMENT);
  }
  start();
  if (failure) return { failure };

  // Takes packed splats: 8 words each.
  function splats({ head, read }) {
    const words = read(Uint32Array, head.count * 8);
    if (cloud) { gl.deleteTexture(cloud.texture); gl.deleteBuffer(cloud.buffer); gl.deleteVertexArray(cloud.array); }
    const rows = Math.max(1, Math.ceil(head.count / 512));
    const padded = new Uint32Array(rows * 4096);
    padded.set(words);
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32UI, 1024, rows, 0, gl.RGBA_INTEGER, gl.UNSIGNED_INT, padded);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    const buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, head.count * 4, gl.DYNAMIC_DRAW);
    const place = splatProgram.attribute("index");
    gl.enableVertexAttribArray(place);
    gl.vertexAttribIPointer(place, 1, gl.UNSIGNED_INT, 4, 0);
    gl.vertexAttribDivisor(place, 1);
    gl.bindVertexArray(null);
    cloud = { ...head, texture, buffer, array, floats: new Float32Array(words.buffer, words.byteOffset, words.length), order: new Uint32Array(head.count), sorted: null };
    return cloud;
  }

  // Takes a packed surface under a name; returns its bounds in its own frame.
  function mesh(name, { head, read }) {
    remove(name);
    const positions = read(Float32Array, head.vertices * 3);
    const normals = head.normals ? read(Float32Array, head.vertices * 3) : null;
    const colours = read(Uint8Array, head.vertices * 4);
    const corners = read(Uint32Array, head.triangles * 3);
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    const buffers = [];
    const fill = (target, data) => { const buffer = gl.createBuffer(); gl.bindBuffer(target, buffer); gl.bufferData(target, data, gl.STATIC_DRAW); buffers.push(buffer); };
    for (const [attribute, data, size, type] of [["position", positions, 3, gl.FLOAT], ["normal", normals, 3, gl.FLOAT], ["colour", colours, 4, gl.UNSIGNED_BYTE]]) {
      const place = meshProgram.attribute(attribute);
      if (!data || place < 0) continue;
      fill(gl.ARRAY_BUFFER, data);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, size, type, type === gl.UNSIGNED_BYTE, 0, 0);
    }
    fill(gl.ELEMENT_ARRAY_BUFFER, corners);
    gl.bindVertexArray(null);
    const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
    for (let i = 0; i < positions.length; i += 1) {
      const axis = i % 3;
      const value = positions[i] + head.origin[axis];
      if (value < low[axis]) low[axis] = value;
      if (value > high[axis]) high[axis] = value;
    }
    const made = { ...head, array, buffers, count: corners.length, smooth: Boolean(normals), low, high };
    meshes.set(name, made);
    return made;
  }

  function remove(name) {
    const known = meshes.get(name);
    if (!known) return;
    gl.deleteVertexArray(known.array);
    for (const buffer of known.buffers) gl.deleteBuffer(buffer);
    meshes.delete(name);
  }

  // Nearest and farthest depth. Depth of 24 bits distinguishes nearer surfaces better if the near plane is far.
  function planes(scale) { return [scale * 1e-3, scale * 1e3]; }

  function uniforms({ at }, view, size, ratio, range) {
    const [right, down, forward] = view.axes();
    const { fx, fy, cx, cy } = view.lens();
    gl.uniformMatrix3fv(at("view"), false, [0, 1, 2].flatMap((i) => [right[i], down[i], forward[i]]));
    gl.uniform4f(at("lens"), fx * ratio, fy * ratio, cx * ratio, cy * ratio);
    gl.uniform2f(at("size"), ...size);
    gl.uniform2f(at("range"), ...range);
    return forward;
  }

  function drawMesh(view, name, matrix, mixed, frameUp) {
    const one = meshes.get(name);
    if (!one) return;
    const axes = [0, 1, 2].map((i) => column(matrix, i));
    const origin = [0, 1, 2].map((i) => axes[0][i] * one.origin[0] + axes[1][i] * one.origin[1] + axes[2][i] * one.origin[2] + matrix[12 + i]);
    const { at } = meshProgram;
    gl.uniformMatrix3fv(at("linear"), false, axes.flat());
    gl.uniform3f(at("offset"), ...sub(origin, view.eye));
    gl.uniform1i(at("flat_shaded"), one.smooth ? 0 : 1);
    gl.uniform4f(at("mixed"), ...mixed);
    gl.uniform3f(at("up"), ...view.axes().map((axis) => dot(axis, frameUp)));
    gl.bindVertexArray(one.array);
    gl.drawElements(gl.TRIANGLES, one.count, gl.UNSIGNED_INT, 0);
  }

  // Draws the scene. `solids` are [name, matrix]; `ghost` is a mesh in the world that is drawn transparently. Splats
  // nearer than `near`, or higher than `cut`, are left out. Only every `stride`th splat is drawn, with as many times the
  // area. Returns the time in milliseconds if it is `timed`, which waits for the end.
  function draw(view, { solids, ghost, showSplats, scale, near, cut, ratio, stride, timed }) {
    const begin = performance.now();
    const size = view.size.map((v) => Math.max(1, Math.round(v * ratio)));
    if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
    gl.viewport(0, 0, ...size);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const range = planes(scale);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const { up } = view.frame;
    // Relative to the eye.
    const ceiling = Math.min(1e30, cut - dot(view.eye, up));
    const meshed = (opacity, list, top = 1e30) => {
      gl.useProgram(meshProgram.made);
      gl.uniform3f(meshProgram.at("above"), ...up);
      gl.uniform1f(meshProgram.at("cut"), top);
      uniforms(meshProgram, view, size, ratio, range);
      gl.uniform1f(meshProgram.at("opacity"), opacity);
      for (const [name, matrix, mixed] of list) drawMesh(view, name, matrix, mixed, up);
    };
    gl.disable(gl.BLEND);
    meshed(1, solids.map(([name, matrix]) => [name, matrix, [0, 0, 0, 0]]));
    if (showSplats && cloud?.count) {
      gl.useProgram(splatProgram.made);
      const forward = uniforms(splatProgram, view, size, ratio, range);
      gl.uniform1f(splatProgram.at("near"), near);
      gl.uniform1f(splatProgram.at("cut"), ceiling);
      gl.uniform3f(splatProgram.at("up"), ...up);
      gl.uniform3f(splatProgram.at("offset"), ...sub(cloud.origin, view.eye));
      gl.bindVertexArray(cloud.array);
      // The order of planar depths depends only on the direction.
      gl.uniform1f(splatProgram.at("larger"), stride);
      if (!cloud.sorted || cloud.stride !== stride || dot(cloud.sorted, forward) < 1 - 1e-7) {
        cloud.drawn = backToFront(cloud.floats, cloud.count, forward, cloud.order, stride);
        cloud.stride = stride;
        gl.bindBuffer(gl.ARRAY_BUFFER, cloud.buffer);
        gl.bufferSubData(gl.ARRAY_BUFFER, 0, cloud.order);
        cloud.sorted = forward;
      }
      gl.activeTexture(gl.TEXTURE0);
      gl.bindTexture(gl.TEXTURE_2D, cloud.texture);
      gl.uniform1i(splatProgram.at("splats"), 0);
      gl.enable(gl.BLEND);
      gl.depthMask(false);
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, cloud.drawn);
      gl.depthMask(true);
    }
    if (ghost && meshes.has(ghost)) {
      // The nearest surface only: first depth, then colour.
      const whole = [[ghost, IDENTITY, [0.62, 0.74, 0.9, 0.8]]];
      gl.clear(gl.DEPTH_BUFFER_BIT);
      gl.colorMask(false, false, false, false);
      meshed(1, whole, ceiling);
      meshed(1, solids.map(([name, matrix]) => [name, matrix, [0, 0, 0, 0]]));
      gl.colorMask(true, true, true, true);
      gl.enable(gl.BLEND);
      meshed(showSplats ? 0.6 : 1, whole, ceiling);
    }
    gl.bindVertexArray(null);
    if (!timed) return null;
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    return performance.now() - begin;
  }

  return { splats, mesh, remove, draw, has: (name) => meshes.has(name), bounds: (name) => meshes.get(name), cloud: () => cloud, failure: null, gl };
}
