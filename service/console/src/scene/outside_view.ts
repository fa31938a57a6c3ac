/** The view from outside: turned about its middle, or from straight above as a plan, which keeps lengths. */

import { MOUSE, type PerspectiveCamera, TOUCH, Vector3 as V3 } from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";

import type { Vector3 } from "../api/types.ts";
import { OrbitKeys } from "./orbit_keys.ts";

const FOV_DEG = 45;
/** So narrow, from so far, that heights shift nothing by more than a hundredth: every painter draws a plan as it draws all else. */
const PLAN_FOV_DEG = 1;
const PLAN_MARGIN = 1.1;
/** A notch of the wheel brings a seventh nearer. */
const ZOOM_SPEED = 3;
const LOWEST = Math.PI * 0.98;

export interface Bounds {
  min: Vector3;
  max: Vector3;
}

export class OutsideView {
  readonly orbit: OrbitControls;
  readonly keys: OrbitKeys;
  isPlan = false;
  /** From where it looked, while somebody stands inside. */
  private held: V3 | null = null;
  bounds: Bounds = { min: [-1, -1, -1], max: [1, 1, 1] };
  private readonly camera: PerspectiveCamera;

  constructor(canvas: HTMLCanvasElement, camera: PerspectiveCamera, changed: () => void) {
    this.camera = camera;
    this.orbit = new OrbitControls(camera, canvas);
    this.orbit.zoomToCursor = true;
    this.orbit.zoomSpeed = ZOOM_SPEED;
    this.orbit.addEventListener("change", changed);
    this.keys = new OrbitKeys(canvas, camera, this.orbit, changed);
  }

  /** Leave the camera to somebody who stands inside. */
  hold(): void {
    this.held = this.camera.position.clone();
    this.orbit.enabled = false;
  }

  /** Look from where it was held, or show the whole scan where that is another one now. */
  resume(): void {
    if (this.held === null) return this.reset();
    this.camera.position.copy(this.held);
    this.begin();
  }

  /** Show the whole scan. */
  reset(): void {
    const { min, max } = this.bounds;
    const middle = new V3((min[0] + max[0]) / 2, (min[1] + max[1]) / 2, (min[2] + max[2]) / 2 - 0.1 * (max[2] - min[2]));
    this.orbit.target.copy(middle);
    if (this.isPlan) {
      const half = (PLAN_MARGIN / 2) * Math.max(max[1] - min[1], (max[0] - min[0]) / this.camera.aspect);
      const away = half / Math.tan((PLAN_FOV_DEG / 360) * Math.PI);
      // A hair to the south, so that north is up.
      this.camera.position.set(middle.x, middle.y - 1e-6 * away, middle.z + away);
    } else {
      const away = 1.18 * this.size * Math.max(1, 1.1 / Math.max(0.3, this.camera.aspect));
      this.camera.position.set(middle.x - 0.42 * away, middle.y - 0.62 * away, middle.z + 0.68 * away);
    }
    this.begin();
  }

  /** What was held is of another scan. */
  forget(): void {
    this.held = null;
  }

  private begin(): void {
    this.held = null;
    this.orbit.enabled = true;
    this.orbit.minPolarAngle = 0;
    this.orbit.maxPolarAngle = this.isPlan ? 0 : LOWEST;
    this.orbit.mouseButtons.LEFT = this.isPlan ? MOUSE.PAN : MOUSE.ROTATE;
    this.orbit.touches.ONE = this.isPlan ? TOUCH.PAN : TOUCH.ROTATE;
    this.camera.fov = this.isPlan ? PLAN_FOV_DEG : FOV_DEG;
    this.camera.updateProjectionMatrix();
    this.orbit.update();
  }

  /** Let nothing of the scan be too near or too far to be drawn, and depths be as fine as they can. */
  fitDepths(): void {
    const away = this.camera.position.distanceTo(this.orbit.target);
    this.camera.near = Math.max(this.size / 500, away - 2 * this.size);
    this.camera.far = away + 2 * this.size;
    this.camera.updateProjectionMatrix();
  }

  /** Width of a pixel at the middle of the view, metres; height: of the view, pixels. */
  metresPerPixel(height: number): number {
    return (2 * this.camera.position.distanceTo(this.orbit.target) * Math.tan((this.camera.fov / 360) * Math.PI)) / height;
  }

  get size(): number {
    const { min, max } = this.bounds;
    return Math.hypot(max[0] - min[0], max[1] - min[1], max[2] - min[2]);
  }

  dispose(): void {
    this.keys.dispose();
    this.orbit.dispose();
  }
}
