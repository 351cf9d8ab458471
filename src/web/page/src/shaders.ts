// What the graphics processor does with the rows of a path. Both shaders say `highp`: an integer uniform that they share
// would otherwise have two precisions, and the program would not link.

/** Kinds of a row that are told in its shade: below 0, no place on the scale. */
export const SHADE = { rapid: -1, plunge: -2 } as const;

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
  float w = kind == -1.0 ? width * 0.55 : width;
  gl_Position = end < 0.5 ? p : q;
  gl_Position.xy += (vec2(-unit.y, unit.x) * side + unit * (end * 2.0 - 1.0) * 0.5) * w * pixel * gl_Position.w;
  time = mix(timeB.x, timeB.y, end);
  along = end * length_;
}`;

export const FRAGMENT = `#version 300 es
precision highp float; precision highp int;
in float time; in float along; flat in float kind;
uniform float now; uniform int plain; uniform vec4 ink; uniform vec3 rapid; uniform vec3 plunge; uniform vec3 future;
uniform vec3 scale[6];
out vec4 color;
void main() {
  if (plain == 1) { color = vec4(ink.rgb * ink.a, ink.a); return; }
  vec3 c; float alpha = 1.0;
  if (kind == -1.0) { if (mod(along, 9.0) > 5.0) discard; c = rapid; alpha = 0.8; }
  else if (kind == -2.0) c = plunge;
  else {
    float x = clamp(kind, 0.0, 1.0) * 5.0;
    int i = int(min(floor(x), 4.0));
    c = mix(scale[i], scale[i + 1], x - float(i));
  }
  if (time > now) { c = mix(c, future, 0.85); alpha *= 0.5; }
  color = vec4(c * alpha, alpha);
}`;
