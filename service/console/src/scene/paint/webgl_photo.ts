/** A photo around its camera: each direction shows the pixel that shows it, of a panorama as of a photo with edges. */

import { CanvasTexture, DoubleSide, GLSL3, LinearFilter, Matrix3, Mesh, NoColorSpace, RepeatWrapping, ShaderMaterial, SphereGeometry } from "three";

import type { CameraOfImage } from "../../api/types.ts";
import { transposed } from "../frames.ts";
import type { PlacedPhoto } from "./painter.ts";

const VERTEX = `
out vec3 direction;
void main() {
  direction = position;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;
const FRAGMENT = `
in vec3 direction;
out vec4 shown;
uniform mat3 cameraFromMap;
uniform sampler2D photo;
uniform float opacity, hfov, aspect;
uniform int model;
const float PI = 3.14159265358979;
void main() {
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
  shown = vec4(textureLod(photo, vec2(at.x, 1.0 - at.y), 0.0).rgb, opacity);
}`;
const MODELS: Record<CameraOfImage["model"], number> = { equirectangular: 0, pinhole: 1, opencv: 1, opencv_fisheye: 2, cylindrical: 3 };
export class WebglPhoto {
  readonly object: Mesh<SphereGeometry, ShaderMaterial>;
  private readonly texture: CanvasTexture;

  constructor({ canvas, camera, place }: PlacedPhoto) {
    const { width, height } = canvas;
    const texture = new CanvasTexture(canvas);
    texture.colorSpace = NoColorSpace;
    texture.generateMipmaps = false;
    texture.minFilter = LinearFilter;
    texture.wrapS = RepeatWrapping;
    this.texture = texture;
    const uniforms = {
      cameraFromMap: { value: new Matrix3().set(...(transposed(place.rotation).flat() as Nine)) },
      photo: { value: texture },
      opacity: { value: 1 },
      hfov: { value: (camera.hfov_deg * Math.PI) / 180 },
      aspect: { value: width / height },
      model: { value: MODELS[camera.model] },
    };
    const material = new ShaderMaterial({
      glslVersion: GLSL3, vertexShader: VERTEX, fragmentShader: FRAGMENT, uniforms, transparent: true, depthTest: false, depthWrite: false,
      side: DoubleSide,
    });
    this.object = new Mesh(new SphereGeometry(1, 32, 16), material);
    this.object.position.set(...place.position);
    this.object.frustumCulled = false;
    this.object.renderOrder = 10;
  }

  set opacity(share: number) {
    this.object.material.uniforms["opacity"]!.value = share;
    this.object.visible = share > 0.002;
  }

  dispose(): void {
    this.object.geometry.dispose();
    this.object.material.dispose();
    this.texture.dispose();
  }
}

type Nine = [number, number, number, number, number, number, number, number, number];
