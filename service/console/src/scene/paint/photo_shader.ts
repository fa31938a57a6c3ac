/** Where a direction is in a photo, in GLSL; `processor_photo.ts` says the same in TypeScript. */

import type { CameraOfImage } from "../../api/types.ts";

/** Values of `model`. */
export const MODELS: Record<CameraOfImage["model"], number> = { equirectangular: 0, pinhole: 1, opencv: 1, opencv_fisheye: 2, cylindrical: 3 };

/** Defines `shownAt`: the colour in a direction of the map, or nothing where the photo does not show it. */
export const SHOWN_AT = `
uniform mat3 cameraFromMap;
uniform sampler2D photo;
uniform float opacity, hfov, aspect;
uniform int model;
const float PI = 3.14159265358979;
vec4 shownAt(vec3 direction) {
  vec3 d = normalize(cameraFromMap * direction);  // x forward, y left, z up
  vec2 at;
  if (model == 0) {
    float span = hfov;
    at = vec2(0.5 - atan(d.y, d.x) / span, 0.5 - asin(clamp(d.z, -1.0, 1.0)) * aspect / span);
  } else if (model == 1) {
    if (d.x <= 0.0) discard;
    vec2 plane = vec2(-d.y, -d.z) / d.x / (2.0 * tan(0.5 * hfov));
    at = 0.5 + plane * vec2(1.0, aspect);
  } else if (model == 2) {
    float off = acos(clamp(d.x, -1.0, 1.0));
    vec2 side = vec2(-d.y, -d.z) / max(1e-6, length(d.yz)) * off / hfov;
    at = 0.5 + side * vec2(1.0, aspect);
  } else {
    at = vec2(0.5 - atan(d.y, d.x) / hfov, 0.5 - d.z / max(1e-6, length(d.xy)) * aspect / hfov);
  }
  if (at.y < 0.0 || at.y > 1.0 || (hfov < 6.28 && (at.x < 0.0 || at.x > 1.0))) discard;
  return vec4(textureLod(photo, at, 0.0).rgb, opacity);
}`;
