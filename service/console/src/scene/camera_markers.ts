/** Cameras in the scene: a dot where each stood, an arrow the way it looked, on top of the points. */

import { Color, ConeGeometry, Group, Mesh, MeshBasicMaterial, SphereGeometry, Vector3 as V3 } from "three";
import type { Camera } from "three";

import { type Place3, applied } from "./frames.ts";

export interface Marker {
  place: Place3;
  /** A number that whoever made the marker knows it by. */
  index: number;
  isChosen: boolean;
  isUnsure: boolean;
}

/** Of the view's height, so that a marker can be hit from afar. */
const SIZE = 0.018;
const NEAREST_M = 0.25;

export class CameraMarkers {
  readonly object = new Group();
  private markers: Marker[] = [];
  private readonly sphere = new SphereGeometry(1, 20, 14);
  private readonly arrow = new ConeGeometry(0.8, 1.7, 20).translate(0, 2.6, 0);

  constructor() {
    this.object.renderOrder = 20;
  }

  show(markers: Marker[], colors: { accent: string; unsure: string; rim: string }): void {
    this.object.clear();
    this.markers = markers;
    for (const marker of markers) {
      const color = new Color(marker.isUnsure ? colors.unsure : colors.accent);
      const each = new Group();
      const rim = new Mesh(this.sphere, new MeshBasicMaterial({ color: new Color(colors.rim), depthTest: false }));
      rim.scale.setScalar(marker.isChosen ? 1.45 : 1.2);
      const dot = new Mesh(this.sphere, new MeshBasicMaterial({ color, depthTest: false }));
      dot.scale.setScalar(marker.isChosen ? 1.1 : 0.85);
      const arrow = new Mesh(this.arrow, new MeshBasicMaterial({ color, depthTest: false }));
      const ahead = applied(marker.place.rotation, [1, 0, 0]);
      arrow.quaternion.setFromUnitVectors(new V3(0, 1, 0), new V3(...ahead));
      rim.renderOrder = 20;
      dot.renderOrder = arrow.renderOrder = 21;
      each.add(rim, dot, arrow);
      each.position.set(...marker.place.position);
      this.object.add(each);
    }
  }

  /** Keep all markers equally large on the screen; isInside: hide the one in whose place the viewer stands. */
  scaleTo(camera: Camera, tanHalfFov: number, isInside: boolean): void {
    for (const each of this.object.children) {
      const distance = camera.position.distanceTo(each.position);
      each.visible = !isInside || distance > NEAREST_M;
      each.scale.setScalar(Math.max(0.02, distance * tanHalfFov * SIZE));
    }
  }

  /** Return the marker under a point of the screen (-1..1 both ways), null where there is none. */
  at(pointer: [number, number], camera: Camera, aspect: number): Marker | null {
    let [nearest, best]: [Marker | null, number] = [null, 0.045];
    for (const marker of this.markers) {
      const seen = new V3(...marker.place.position);
      if (camera.position.distanceTo(seen) < NEAREST_M) continue;
      seen.project(camera);
      const distance = Math.hypot((seen.x - pointer[0]) * aspect, seen.y - pointer[1]);
      if (seen.z < 1 && distance < best) [nearest, best] = [marker, distance];
    }
    return nearest;
  }
}
