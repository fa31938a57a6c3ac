/** The view from outside by keyboard: arrow keys turn it, with Shift they move it, + and − zoom. */

import { type PerspectiveCamera, Vector3 as V3 } from "three";
import type { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";

const TURN_PER_KEY = Math.PI / 24;
/** Of the distance to the middle of the view, as wide as it is from outside. */
const MOVE_PER_KEY = 0.05;
const ZOOM_PER_KEY = 1.15;
const STEEPEST = 0.02;

export class OrbitKeys {
  private readonly element: HTMLElement;
  private readonly camera: PerspectiveCamera;
  private readonly orbit: OrbitControls;
  private readonly changed: () => void;

  constructor(element: HTMLElement, camera: PerspectiveCamera, orbit: OrbitControls, changed: () => void) {
    [this.element, this.camera, this.orbit, this.changed] = [element, camera, orbit, changed];
    element.addEventListener("keydown", this.press);
  }

  dispose(): void {
    this.element.removeEventListener("keydown", this.press);
  }

  /** Turn about the middle, counter-clockwise seen from above and upwards, radians. */
  turn(around: number, up: number): void {
    const from = this.camera.position.clone().sub(this.orbit.target);
    const distance = from.length();
    const polar = Math.min(this.orbit.maxPolarAngle, Math.max(STEEPEST, Math.acos(from.z / distance) - up));
    const azimuth = Math.atan2(from.y, from.x) + around;
    from.set(Math.sin(polar) * Math.cos(azimuth), Math.sin(polar) * Math.sin(azimuth), Math.cos(polar)).multiplyScalar(distance);
    this.placeAt(from);
  }

  private move(right: number, ahead: number): void {
    const from = this.camera.position.clone().sub(this.orbit.target);
    const step = MOVE_PER_KEY * from.length() * (Math.tan((this.camera.fov / 360) * Math.PI) / Math.tan(Math.PI / 8));
    const forward = new V3(-from.x, -from.y, 0).normalize();
    this.orbit.target.addScaledVector(forward, step * ahead).addScaledVector(new V3(forward.y, -forward.x, 0), step * right);
    this.placeAt(from);
  }

  private zoom(factor: number): void {
    this.placeAt(this.camera.position.clone().sub(this.orbit.target).multiplyScalar(factor));
  }

  private placeAt(fromTarget: V3): void {
    this.camera.position.copy(this.orbit.target).add(fromTarget);
    this.orbit.update();
    this.changed();
  }

  private readonly press = (event: KeyboardEvent): void => {
    if (!this.orbit.enabled || event.ctrlKey || event.altKey || event.metaKey) return;
    const arrows: Record<string, [number, number]> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const arrow = arrows[event.key];
    // From straight above nothing is turned.
    if (arrow && (event.shiftKey || this.orbit.maxPolarAngle === 0)) this.move(...arrow);
    else if (arrow) this.turn(arrow[0] * TURN_PER_KEY, arrow[1] * TURN_PER_KEY);
    else if (event.key === "+" || event.key === "=") this.zoom(1 / ZOOM_PER_KEY);
    else if (event.key === "-") this.zoom(ZOOM_PER_KEY);
    else return;
    event.preventDefault();
  };
}
