/** A photo around its camera: each direction shows the pixel that shows it, of a panorama as of a photo with edges. */

import { CanvasTexture, DoubleSide, GLSL3, LinearFilter, Matrix3, Mesh, NoColorSpace, RepeatWrapping, ShaderMaterial, SphereGeometry } from "three";

import { transposed } from "../frames.ts";
import type { PlacedPhoto } from "./painter.ts";
import { MODELS, SHOWN_AT } from "./photo_shader.ts";

const VERTEX = `
out vec3 direction;
void main() {
  direction = position;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;
const FRAGMENT = `
in vec3 direction;
out vec4 shown;
${SHOWN_AT}
void main() {
  shown = shownAt(direction);
}`;

export class WebglPhoto {
  readonly object: Mesh<SphereGeometry, ShaderMaterial>;
  private readonly texture: CanvasTexture;

  constructor({ canvas, camera, place }: PlacedPhoto) {
    const { width, height } = canvas;
    const texture = new CanvasTexture(canvas);
    texture.colorSpace = NoColorSpace;
    texture.generateMipmaps = false;
    texture.flipY = false;
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
