/** Cameras and points in WebGL: a dot where each is, an arrow the way a camera looked, on top of the scan. */

import { Color, ConeGeometry, Group, Mesh, MeshBasicMaterial, SphereGeometry, Vector3 as V3 } from "three";
import type { Camera } from "three";

import { applied } from "../frames.ts";
import { MARKER_SIZE, type Marker, NEAREST_M } from "../markers.ts";
import type { StageColors } from "./painter.ts";

export class WebglMarkers {
  readonly object = new Group();
  private readonly sphere = new SphereGeometry(1, 20, 14);
  private readonly arrow = new ConeGeometry(0.8, 1.7, 20).translate(0, 2.6, 0);

  constructor() {
    this.object.renderOrder = 20;
  }

  show(markers: Marker[], colors: StageColors): void {
    this.object.clear();
    for (const marker of markers) {
      const color = new Color(marker.isUnsure ? colors.unsure : colors.accent);
      const each = new Group();
      const rim = new Mesh(this.sphere, new MeshBasicMaterial({ color: new Color(colors.rim), depthTest: false }));
      rim.scale.setScalar(marker.isChosen ? 1.45 : 1.2);
      const dot = new Mesh(this.sphere, new MeshBasicMaterial({ color, depthTest: false }));
      dot.scale.setScalar(marker.isChosen ? 1.1 : 0.85);
      rim.renderOrder = 20;
      dot.renderOrder = 21;
      each.add(rim, dot);
      if (marker.place.rotation) {
        const arrow = new Mesh(this.arrow, dot.material);
        arrow.quaternion.setFromUnitVectors(new V3(0, 1, 0), new V3(...applied(marker.place.rotation, [1, 0, 0])));
        arrow.renderOrder = 21;
        each.add(arrow);
      }
      each.position.set(...marker.place.position);
      this.object.add(each);
    }
  }

  /** Keep all markers equally large on the screen; isInside: hide the one in whose place the viewer stands. */
  scaleTo(camera: Camera, tanHalfFov: number, isInside: boolean): void {
    for (const each of this.object.children) {
      const distance = camera.position.distanceTo(each.position);
      each.visible = !isInside || distance > NEAREST_M;
      each.scale.setScalar(Math.max(0.02, distance * tanHalfFov * MARKER_SIZE));
    }
  }
}
