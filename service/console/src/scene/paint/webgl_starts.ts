/** The starts of the search in WebGL: small dots of one size on the screen, in front of the points. */

import { BufferAttribute, BufferGeometry, Color, Points, PointsMaterial } from "three";

const SIZE_PX = 5;

export class WebglStarts {
  readonly object = new Points(new BufferGeometry(), new PointsMaterial({ size: SIZE_PX, sizeAttenuation: false, depthTest: false, transparent: true, opacity: 0.85 }));

  constructor() {
    this.object.renderOrder = 15;
    this.object.frustumCulled = false;
    this.object.visible = false;
  }

  show(positions: Float32Array, color: string): void {
    this.object.geometry.setAttribute("position", new BufferAttribute(positions, 3));
    this.object.material.color = new Color(color);
    this.object.visible = positions.length > 0;
  }
}
