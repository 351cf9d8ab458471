// The shaders that draw the rows of a path, and those that draw a block. Each vertex shader and its fragment shader
// declare `highp`: a uniform that both use must have the same precision in both, or the program does not link.

/** Shades of rows that are not coloured by a value. Shades below 0 have colours of their own. A line has the second of
 * the six colours of the scale, an arc the fifth. */
export const SHADE = { rapid: -1, plunge: -2, crash: -3, line: 0.2, arc: 0.8 } as const;

export const VERTEX = `#version 300 es
precision highp float; precision highp int;
layout(location=0) in vec3 a; layout(location=1) in vec2 timeA;
layout(location=2) in vec3 b; layout(location=3) in vec2 timeB;
layout(location=4) in float shade;
uniform mat4 view; uniform vec2 pixel; uniform float width; uniform int strip;
out float time; out float along; flat out float kind;
void main() {
  kind = shade;
  if (strip == 1) { gl_Position = view * vec4(b, 1.0); time = timeB.y; along = 0.0; return; }
  float end = float(gl_VertexID / 2), side = float(gl_VertexID & 1) * 2.0 - 1.0;
  vec4 p = view * vec4(a, 1.0), q = view * vec4(b, 1.0);
  vec2 way = (q.xy / q.w - p.xy / p.w) / pixel;
  float length_ = length(way);
  vec2 unit = length_ > 1e-6 ? way / length_ : vec2(1.0, 0.0);
  float w = kind == -1.0 ? width * 0.55 : kind == -3.0 ? width * 2.2 : width;
  gl_Position = end < 0.5 ? p : q;
  gl_Position.xy += (vec2(-unit.y, unit.x) * side + unit * (end * 2.0 - 1.0) * 0.5) * w * pixel * gl_Position.w;
  time = mix(timeB.x, timeB.y, end);
  along = end * length_;
}`;

export const FRAGMENT = `#version 300 es
precision highp float; precision highp int;
in float time; in float along; flat in float kind;
uniform float now; uniform int plain; uniform vec4 ink; uniform vec3 rapid; uniform vec3 plunge; uniform vec3 crash; uniform vec3 future; uniform int only; uniform int rapids;
uniform vec3 scale[6];
out vec4 color;
void main() {
  if (plain == 1) { color = vec4(ink.rgb * ink.a, ink.a); return; }
  vec3 c; float alpha = 1.0;
  if (only == 1 && kind != -3.0) discard;
  if (rapids == 0 && kind == -1.0) discard;
  if (kind == -1.0) { if (mod(along, 9.0) > 5.0) discard; c = rapid; alpha = 0.8; }
  else if (kind == -2.0) c = plunge;
  else if (kind == -3.0) c = crash;
  else {
    float x = clamp(kind, 0.0, 1.0) * 5.0;
    int i = int(min(floor(x), 4.0));
    c = mix(scale[i], scale[i + 1], x - float(i));
  }
  if (time > now) { c = mix(c, future, 0.85); alpha *= 0.5; }
  color = vec4(c * alpha, alpha);
}`;

/** Draws a height map as a block. Four neighbouring cells are the corners of a quad. Around the map, a wall reaches
 * down to the bottom. */
export const BLOCK_VERTEX = `#version 300 es
precision highp float; precision highp int; precision highp sampler2D;
uniform mat4 view; uniform sampler2D heights; uniform ivec2 size; uniform int stride; uniform vec4 frame; uniform float bottom;
out vec3 place;
void main() {
  ivec2 quads = (size + stride - 2) / stride + 2;
  int quad = gl_VertexID / 6, corner = gl_VertexID % 6;
  ivec2 off = corner == 0 ? ivec2(0, 0) : corner == 1 || corner == 4 ? ivec2(1, 0) : corner == 2 || corner == 3 ? ivec2(0, 1) : ivec2(1, 1);
  ivec2 at = (ivec2(quad % quads.x, quad / quads.x) + off - 1) * stride;
  ivec2 cell = clamp(at, ivec2(0), size - 1);
  bool outside = at.x < 0 || at.y < 0 || (at.x >= size.x && at.x - stride >= size.x - 1) || (at.y >= size.y && at.y - stride >= size.y - 1);
  float z = outside ? bottom : texelFetch(heights, cell, 0).r;
  // The outermost cells reach to the edge of the block.
  vec2 part = (vec2(cell) + 0.5) / vec2(size);
  part = mix(part, step(0.5, part), vec2(equal(cell, ivec2(0))) + vec2(equal(cell, size - 1)));
  place = vec3(mix(frame.xy, frame.zw, part), z);
  gl_Position = view * vec4(place, 1.0);
}`;

export const BLOCK_FRAGMENT = `#version 300 es
precision highp float; precision highp int;
in vec3 place;
uniform float bottom; uniform float top; uniform vec3 fresh; uniform vec3 cutColor;
out vec4 color;
void main() {
  if (place.z <= bottom + 1e-4 * (top - bottom)) discard;
  vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
  // Which side of a face is seen does not tell: an upright one may be turned either way by rounding.
  float light = 0.5 + 0.5 * abs(dot(normal, normalize(vec3(-0.4, -0.6, 0.9))));
  color = vec4(mix(cutColor, fresh, step(top - 1e-4 * (top - bottom), place.z)) * light, 1.0);
}`;
