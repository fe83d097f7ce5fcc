// The program that draws pictures on the canvas with exposure, tone curve and comparison.

export const VERTEX = `#version 300 es
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0;
  gl_Position = vec4(corner, 0.0, 1.0);
}`;

// Coordinates of pictures are in pixels from the top left corner. `encoding`: 0 linear light, 1 sRGB, 2 data.
export const FRAGMENT = `#version 300 es
precision highp float;
precision highp sampler2D;
uniform sampler2D a, b, flip;
uniform ivec2 sizeA, sizeB;
uniform ivec2 formA, formB;
uniform vec2 rangeA, rangeB;
uniform vec2 view;
uniform vec2 pan;
uniform float zoom, exposure, split;
// Yaw and pitch in radians, focal length in pixels, and 1 if a panorama is looked at from inside.
uniform vec4 sphere;
uniform int mode, curve;
out vec4 colour;

vec3 encoded(vec3 v) {
  vec3 low = v * 12.92, high = 1.055 * pow(max(v, vec3(0.0031308)), vec3(1.0 / 2.4)) - 0.055;
  return mix(high, low, lessThanEqual(v, vec3(0.0031308)));
}
vec3 decoded(vec3 v) {
  vec3 low = v / 12.92, high = pow((max(v, vec3(0.04045)) + 0.055) / 1.055, vec3(2.4));
  return mix(high, low, lessThanEqual(v, vec3(0.04045)));
}
// From black over blue, green, yellow and red to white.
vec3 scale(float t) {
  t = clamp(t, 0.0, 1.0) * 6.0;
  vec3 c[7] = vec3[7](vec3(0.0), vec3(0.13, 0.1, 0.55), vec3(0.0, 0.45, 0.75), vec3(0.1, 0.65, 0.3),
    vec3(0.95, 0.85, 0.2), vec3(0.85, 0.2, 0.1), vec3(1.0));
  int i = min(int(t), 5);
  return mix(c[i], c[i + 1], t - float(i));
}
vec3 shown(vec4 s, ivec2 form, vec2 range) {
  if (form.x == 2 && form.y < 3) {
    float t = isinf(s.r) || isnan(s.r) ? 1.0 : (s.r - range.x) / max(range.y - range.x, 1e-30);
    return curve == 2 ? scale(t) : vec3(t);
  }
  vec3 rgb = form.y < 3 ? vec3(s.r) : s.rgb;
  if (form.x == 2) return 0.5 + 0.5 * rgb;
  if (form.x == 1 && curve == 0 && exposure == 0.0) return rgb;
  vec3 light = (form.x == 1 ? decoded(rgb) : rgb) * exp2(exposure);
  if (curve == 1) return encoded(max(light, 0.0) / (1.0 + max(light, 0.0)));
  // Eight stops below and above middle grey.
  if (curve == 2) return scale((log2(max(dot(light, vec3(0.21267, 0.71516, 0.07217)), 1e-9) / 0.18) + 8.0) / 16.0);
  return curve == 3 ? light : encoded(light);
}
void main() {
  vec2 place = (vec2(gl_FragCoord.x, view.y - gl_FragCoord.y) - pan) / zoom;
  if (sphere.w > 0.5) {
    vec3 d = normalize(vec3((vec2(gl_FragCoord.x, view.y - gl_FragCoord.y) - 0.5 * view) / sphere.z, 1.0));
    float s = sin(sphere.y), c = cos(sphere.y);
    d.yz = vec2(d.y * c - d.z * s, d.y * s + d.z * c);
    float u = 0.5 + (atan(d.x, d.z) + sphere.x) / 6.2831853, v = acos(clamp(-d.y, -1.0, 1.0)) / 3.1415927;
    place = min(vec2(fract(u), v) * vec2(sizeA), vec2(sizeA) - 0.5);
  }
  ivec2 pixel = ivec2(floor(place));
  vec2 ratio = vec2(sizeB) / vec2(max(sizeA, ivec2(1)));
  ivec2 pixelB = ivec2(floor(place * ratio));
  if (any(lessThan(pixel, ivec2(0))) || any(greaterThanEqual(pixel, sizeA))) { colour = vec4(0.0); return; }
  bool second = mode == 2 || (mode == 1 && gl_FragCoord.x > split);
  if (mode == 4) { colour = vec4(scale(texelFetch(flip, pixel, 0).r), 1.0); return; }
  vec3 own = second ? vec3(0.0) : shown(texelFetch(a, pixel, 0), formA, rangeA);
  vec3 other = second || mode == 3 ? shown(texelFetch(b, pixelB, 0), formB, rangeB) : vec3(0.0);
  vec3 result = mode == 3 ? abs(clamp(own, 0.0, 1.0) - clamp(other, 0.0, 1.0)) * 4.0 : second ? other : own;
  colour = vec4(clamp(result, 0.0, 1.0), 1.0);
}`;
