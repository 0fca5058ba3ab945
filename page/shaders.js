// The shaders of mixed reality. Colours are multiplied by their opacity, as the headset's compositor expects.

/**
 * How much of a fragment real things leave visible, 0 to 1, by the device's depth.
 *
 * A texel is a depth of the device's projection, which becomes metres. The place of the real surface on the same line of
 * sight follows from it; what is as low as the floor hides nothing, for a scanned floor is never quite flat.
 */
const OCCLUSION = `
uniform highp sampler2DArray depthTexture;
uniform int depthLayer;
uniform bool hasDepth;
uniform mat4 depthFromView;
uniform vec2 depthRange;
uniform float metresOfRaw;
uniform vec4 viewport;
uniform vec3 eye;
const float FLOOR_BAND_M = 0.05;
const float TOLERANCE_M = 0.02;
const float EDGE_M = 0.04;
const float EDGE_SHARE = 0.015;

float metresAt(vec2 at) {
  float raw = texture(depthTexture, vec3(at, float(depthLayer))).r;
  if (depthRange.x <= 0.0) return raw * metresOfRaw;
  float share = depthRange.y > 0.0 ? 1.0 - depthRange.x / depthRange.y : 1.0;
  return depthRange.x / max(1e-6, 1.0 - raw * share);
}

float visibility(vec3 place, float metres) {
  if (!hasDepth) return 1.0;
  vec2 at = (depthFromView * vec4((gl_FragCoord.xy - viewport.xy) / viewport.zw, 0.0, 1.0)).xy;
  vec2 texel = 1.0 / vec2(textureSize(depthTexture, 0).xy);
  float edge = EDGE_M + EDGE_SHARE * metres;
  float sum = 0.0;
  for (int i = -1; i <= 1; i++) {
    for (int j = -1; j <= 1; j++) {
      float real = metresAt(at + vec2(i, j) * texel);
      float height = eye.y + (place.y - eye.y) * real / metres;
      float hidden = 1.0 - smoothstep(-edge, -TOLERANCE_M, real - metres);
      sum += height < FLOOR_BAND_M || real <= 0.0 ? 1.0 : 1.0 - hidden;
    }
  }
  return sum / 9.0;
}
`;

const COMMON = `#version 300 es
precision highp float;
`;

/** Corners with a place in the room, and its distance along the line of sight. */
const PLACE = `${COMMON}
uniform mat4 model, view, projection;
out vec3 place;
out float metres;
void putAt(vec3 corner) {
  vec4 inRoom = model * vec4(corner, 1.0);
  vec4 inView = view * inRoom;
  place = inRoom.xyz;
  metres = -inView.z;
  gl_Position = projection * inView;
}
`;

const INPUTS = `${COMMON}
in vec3 place;
in float metres;
out vec4 result;
uniform bool ignoresDepth;
`;

/** Lit triangles with one colour, and grey where a corner says so. */
export const SOLID = {
  vertex: `${PLACE}
layout(location = 0) in vec3 corner;
layout(location = 1) in vec3 direction;
layout(location = 2) in float tint;
out vec3 normal;
out float share;
void main() {
  putAt(corner);
  normal = mat3(model) * direction;
  share = tint;
}`,
  fragment: `${INPUTS}${OCCLUSION}
in vec3 normal;
in float share;
uniform vec4 colour;
uniform float light;
void main() {
  float visible = ignoresDepth ? 1.0 : visibility(place, metres);
  if (visible < 0.02) discard;
  vec3 base = share >= 0.99 ? colour.rgb : vec3(0.05 + 0.75 * share);
  float lit = 0.62 + 0.38 * max(0.0, dot(normalize(normal), normalize(vec3(0.35, 0.85, 0.4))));
  float opacity = colour.a * visible;
  result = vec4(base * mix(1.0, lit, light) * opacity, opacity);
}`,
};

/** A texture on a rectangle: corners 0 to 1 in both directions, the texture's first row at 0. */
export const TEXTURED = {
  vertex: `${PLACE}
layout(location = 0) in vec2 corner;
out vec2 at;
void main() {
  putAt(vec3(corner, 0.0));
  at = corner;
}`,
  fragment: `${INPUTS}${OCCLUSION}
in vec2 at;
uniform sampler2D image;
uniform float opacity;
void main() {
  vec4 pixel = texture(image, at) * opacity;
  if (pixel.a < 0.004) discard;
  float visible = ignoresDepth ? 1.0 : visibility(place, metres);
  result = pixel * visible;
}`,
};

/** Points of a scan, as large as they are in the room. */
export const POINTS = {
  vertex: `${PLACE}
layout(location = 0) in vec3 corner;
uniform float size;
uniform float pixels;
void main() {
  putAt(corner);
  gl_PointSize = clamp(size * projection[1][1] * pixels * 0.5 / max(0.1, metres), 2.0, 24.0);
}`,
  fragment: `${INPUTS}${OCCLUSION}
uniform vec4 colour;
void main() {
  vec2 from = gl_PointCoord * 2.0 - 1.0;
  float disc = 1.0 - smoothstep(0.7, 1.0, dot(from, from));
  float opacity = colour.a * disc * (ignoresDepth ? 1.0 : visibility(place, metres));
  if (opacity < 0.02) discard;
  result = vec4(colour.rgb * opacity, opacity);
}`,
};

/** The scanned room: it is not seen, but hides what is behind it. Its floor does not. */
export const ROOM = {
  vertex: `${PLACE}
layout(location = 0) in vec3 corner;
void main() { putAt(corner); }`,
  fragment: `${COMMON}
in vec3 place;
in float metres;
out vec4 result;
void main() {
  if (place.y < 0.05) discard;
  result = vec4(0.0);
}`,
};
