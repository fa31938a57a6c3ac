/** The 3D view: the scan from outside, turned about its middle, or from where a photo was taken, with the photo in front of the points. */

import { Matrix4, PerspectiveCamera, Vector3 as V3 } from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";

import type { CameraOfImage, Vector3 } from "../api/types.ts";
import type { SceneCell } from "./change_tint.ts";
import { directionAngles, type Place3, viewRotation } from "./frames.ts";
import { LookAround } from "./look_around.ts";
import { OrbitKeys } from "./orbit_keys.ts";
import { type Marker, markerAt } from "./markers.ts";
import { makePainter } from "./paint/make_painter.ts";
import type { Painter, StageColors } from "./paint/painter.ts";
import { decodePhoto } from "./photo.ts";
import { pickPoint } from "./pick.ts";
import type { PointChunk } from "./point_decoder.ts";

const OUTSIDE_FOV_DEG = 45;
const INSIDE_FOV_DEG = 75;
/** Of the scan's height that is shown from outside: ceilings hide what is below them. */
const SHOWN_HEIGHT = 0.82;
const STILL_AFTER_MS = 180;
/** A tab that is not seen draws nothing; what it waits for comes all the same. */
const HIDDEN_MS = 300;

export class Stage {
  onMarker: (index: number) => void = () => undefined;
  /** Where clicks meet the scan, in the world of the renderer, null where they miss it; while this is set, they choose no markers. */
  onPick: ((at: Vector3 | null) => void) | null = null;
  /** Where somebody who stands looks: counter-clockwise from +x, radians. */
  onLook: (yaw: number) => void = () => undefined;
  private readonly painter: Painter;
  private readonly camera = new PerspectiveCamera(OUTSIDE_FOV_DEG, 1, 0.05, 5000);
  private readonly orbit: OrbitControls;
  private readonly keys: OrbitKeys;
  private readonly look: LookAround;
  private readonly canvas: HTMLCanvasElement;
  private markers: Marker[] = [];
  private numPoints = 0;
  private total = 0;
  private cut = Infinity;
  private standing: Place3 | null = null;
  private bounds: { min: Vector3; max: Vector3 } = { min: [-1, -1, -1], max: [1, 1, 1] };
  private moved = 0;
  private frame = 0;
  private lastMoving = 0;
  private isTouched = true;
  private isAnew = true;
  private isFull = false;
  private pressed: [number, number] | null = null;

  constructor(canvas: HTMLCanvasElement, colors: StageColors) {
    this.canvas = canvas;
    this.painter = makePainter(canvas, colors);
    this.camera.up.set(0, 0, 1);
    this.orbit = new OrbitControls(this.camera, canvas);
    this.orbit.addEventListener("change", () => this.touch());
    this.orbit.maxPolarAngle = Math.PI * 0.98;
    this.keys = new OrbitKeys(canvas, this.camera, this.orbit, () => this.touch());
    this.look = new LookAround(canvas, () => this.turned());
    canvas.addEventListener("pointerdown", this.down);
    canvas.addEventListener("pointerup", this.up);
    canvas.addEventListener("keydown", this.press);
  }

  recolor(colors: StageColors): void {
    this.painter.recolor(colors);
    this.refresh();
  }

  /** Begin a scan of so many points; bounds: in the world of the renderer. */
  begin(numPoints: number, bounds: { min: Vector3; max: Vector3 }): void {
    [this.numPoints, this.total, this.bounds] = [0, numPoints, bounds];
    this.painter.begin(numPoints);
    if (this.standing === null) this.leave();
  }

  /** Add points; ends once they may have been drawn, so that whoever brings them leaves time for that. */
  async grow(chunk: PointChunk): Promise<void> {
    this.painter.grow(chunk);
    this.numPoints += chunk.colors.length;
    this.refresh();
    await new Promise<void>((resolve) => {
      requestAnimationFrame(() => resolve());
      setTimeout(resolve, HIDDEN_MS);
    });
  }

  show(markers: Marker[]): void {
    this.markers = markers;
    this.painter.showMarkers(markers);
    this.refresh();
  }

  /** Show the starts of the search, (n, 3) in the world of the renderer. */
  showStarts(positions: Float32Array): void {
    this.painter.showStarts(positions);
    this.refresh();
  }

  /** Tint the points in cells of space in which something changed. */
  tint(cells: SceneCell[], side: number): void {
    this.painter.tint(cells, side);
    this.refresh();
  }

  /** Stand where a photo was taken, with the photo before the points where there is one. */
  async stand(place: Place3, photo: Blob | null, camera: CameraOfImage): Promise<void> {
    this.standing = place;
    this.orbit.enabled = false;
    this.painter.showPhoto(null);
    const isWhole = camera.hfov_deg > 300;
    const [yaw, pitch] = directionAngles(place.rotation);
    this.look.begin(yaw, pitch, isWhole ? null : place.rotation, isWhole ? INSIDE_FOV_DEG : this.fovOf(camera));
    if (isWhole) this.look.pitch = 0;
    this.cut = Infinity;
    this.turned();
    if (photo === null) return;
    const canvas = await decodePhoto(photo);
    if (this.standing !== place) return;
    this.painter.showPhoto({ canvas, camera, place });
    this.touch();
  }

  /** Go back outside. */
  leave(): void {
    this.standing = null;
    this.look.end();
    this.painter.showPhoto(null);
    this.orbit.enabled = true;
    const { min, max } = this.bounds;
    const middle = new V3((min[0] + max[0]) / 2, (min[1] + max[1]) / 2, (min[2] + max[2]) / 2 - 0.1 * (max[2] - min[2]));
    const size = Math.hypot(max[0] - min[0], max[1] - min[1], max[2] - min[2]);
    this.camera.fov = OUTSIDE_FOV_DEG;
    this.camera.near = size / 500;
    this.camera.far = size * 20;
    const away = 1.18 * size * Math.max(1, 1.1 / Math.max(0.3, this.camera.aspect));
    this.camera.position.set(middle.x - 0.42 * away, middle.y - 0.62 * away, middle.z + 0.68 * away);
    this.camera.updateProjectionMatrix();
    this.orbit.target.copy(middle);
    this.orbit.update();
    this.cut = min[2] + SHOWN_HEIGHT * (max[2] - min[2]);
    this.touch();
  }

  /** Show so much of the photo (1) or of the points (0). */
  fade(share: number): void {
    this.painter.fade(share);
    if (this.painter.isFadedQuickly) this.refresh();
    else this.touch();
  }

  resize(width: number, height: number): void {
    if (width < 1 || height < 1) return;
    this.painter.resize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.touch();
  }

  /** Return where the scan is under a point of the view (-1..1 both ways), in the world of the renderer; null where there is none. */
  pick(x: number, y: number): Vector3 | null {
    const { camera, painter, bounds } = this;
    camera.updateMatrixWorld();
    const direction = new V3(x, y, 0.5).unproject(camera).sub(camera.position).normalize().toArray();
    const far = Math.max(...[bounds.min, bounds.max].map((corner) => camera.position.distanceTo(new V3(...corner)))) + new V3(...bounds.min).distanceTo(new V3(...bounds.max));
    const pixel = (2 * Math.tan((camera.fov / 360) * Math.PI)) / Math.max(1, this.canvas.clientHeight);
    const ray = { origin: camera.position.toArray(), direction, near: camera.near, far, cut: this.cut, pixel };
    return pickPoint(painter.points.chunks, ray, painter.points.widthOf(painter.points.numPoints));
  }

  /** What a test or a measurement asks: where one stands, what was drawn, and with what. */
  state(): { numDrawn: number; numPoints: number; isStill: boolean; isStanding: boolean; renderer: string } {
    return {
      numDrawn: this.painter.numDrawn,
      numPoints: this.numPoints,
      isStill: this.frame === 0 && this.isFull && this.numPoints === this.total,
      isStanding: this.standing !== null,
      renderer: this.painter.name,
    };
  }

  /** Turn about the middle by so many degrees, as dragging does. */
  spin(degrees: number): void {
    this.keys.turn((degrees / 180) * Math.PI, 0);
  }

  dispose(): void {
    cancelAnimationFrame(this.frame);
    this.keys.dispose();
    this.look.dispose();
    this.orbit.dispose();
    this.painter.dispose();
    this.canvas.removeEventListener("pointerdown", this.down);
    this.canvas.removeEventListener("pointerup", this.up);
    this.canvas.removeEventListener("keydown", this.press);
  }

  private fovOf(camera: CameraOfImage): number {
    const half = (Math.min(camera.hfov_deg, 110) / 360) * Math.PI;
    return Math.min(100, (2 * Math.atan((Math.tan(half) * 1.15) / Math.max(0.6, this.camera.aspect)) * 180) / Math.PI + 12);
  }

  private turned(): void {
    if (this.standing === null) return;
    const r = viewRotation(this.look.rotation);
    const matrix = new Matrix4().set(r[0][0], r[0][1], r[0][2], 0, r[1][0], r[1][1], r[1][2], 0, r[2][0], r[2][1], r[2][2], 0, 0, 0, 0, 1);
    this.camera.quaternion.setFromRotationMatrix(matrix);
    this.camera.position.set(...this.standing.position);
    this.camera.fov = this.look.fovDeg;
    this.camera.near = 0.03;
    this.camera.updateProjectionMatrix();
    this.onLook(directionAngles(this.look.rotation)[0]);
    this.touch();
  }

  /** The view changed: draw quickly now, and fully once it has not changed for a moment. */
  private touch(): void {
    this.moved = performance.now();
    this.isTouched = true;
    this.refresh();
  }

  /** Something is to be drawn that was not there. */
  private refresh(): void {
    this.isFull = false;
    if (this.frame === 0) this.frame = requestAnimationFrame(this.draw);
  }

  private readonly draw = (now: number): void => {
    this.camera.updateMatrixWorld();
    const view = { camera: this.camera, isInside: this.standing !== null, cut: this.cut };
    // The first picture waits for nothing.
    const isMoving = this.painter.numDrawn > 0 && performance.now() - this.moved < STILL_AFTER_MS;
    if (this.isTouched) {
      this.painter.drawMoving(view, this.lastMoving > 0 ? now - this.lastMoving : 0);
      this.isTouched = false;
      this.isAnew = true;
      this.lastMoving = now;
    } else if (isMoving) {
      this.lastMoving = 0;
    } else {
      this.lastMoving = 0;
      this.isFull = this.painter.drawStill(view, this.isAnew);
      this.isAnew = false;
    }
    this.frame = this.isFull ? 0 : requestAnimationFrame(this.draw);
  };

  private readonly down = (event: PointerEvent): void => {
    this.pressed = [event.clientX, event.clientY];
  };

  private readonly up = (event: PointerEvent): void => {
    if (this.pressed === null) return;
    const box = this.canvas.getBoundingClientRect();
    const wasClick = Math.hypot(event.clientX - this.pressed[0], event.clientY - this.pressed[1]) < 5;
    const at: [number, number] = [((event.clientX - box.left) / box.width) * 2 - 1, 1 - ((event.clientY - box.top) / box.height) * 2];
    this.pressed = null;
    if (!wasClick) return;
    if (this.onPick) return this.onPick(this.pick(...at));
    const marker = markerAt(this.markers, at, this.camera, this.camera.aspect);
    if (marker) this.onMarker(marker.index);
  };

  /** By keyboard one picks what is in the middle. */
  private readonly press = (event: KeyboardEvent): void => {
    if (event.key !== "Enter" || this.onPick === null) return;
    event.preventDefault();
    this.onPick(this.pick(0, 0));
  };
}
