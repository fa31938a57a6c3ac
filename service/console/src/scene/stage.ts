/** The 3D view: the scan from outside, turned about its middle, or from where a photo was taken, with the photo in front of the points. */

import { Matrix4, PerspectiveCamera, Vector3 as V3 } from "three";

import type { CameraOfImage, Vector3 } from "../api/types.ts";
import type { SceneCell } from "./change_tint.ts";
import { Clicks } from "./clicks.ts";
import { directionAngles, type Place3, viewRotation } from "./frames.ts";
import { LookAround } from "./look_around.ts";
import { type Marker, markerAt } from "./markers.ts";
import { type Bounds, OutsideView } from "./outside_view.ts";
import { makePainter } from "./paint/make_painter.ts";
import type { Painter, StageColors } from "./paint/painter.ts";
import { decodePhoto } from "./photo.ts";
import type { PointChunk } from "./point_decoder.ts";
import { isClear, pickUnder } from "./sight.ts";

const INSIDE_FOV_DEG = 75;
const STILL_AFTER_MS = 180;
/** A tab that is not seen draws nothing; what it waits for comes all the same. */
const HIDDEN_MS = 300;

export class Stage {
  onMarker: (index: number) => void = () => undefined;
  /** Where clicks meet the scan, in the world of the renderer, null where they miss it; while this is set, they choose no markers. */
  onPick: ((at: Vector3 | null) => void) | null = null;
  /** Where somebody who stands looks: counter-clockwise from +x, radians. */
  onLook: (yaw: number) => void = () => undefined;
  /** Called after each picture. */
  onDraw: () => void = () => undefined;
  readonly outside: OutsideView;
  private readonly painter: Painter;
  private readonly clicks: Clicks;
  private readonly camera = new PerspectiveCamera(45, 1, 0.05, 5000);
  private readonly look: LookAround;
  private readonly canvas: HTMLCanvasElement;
  private markers: Marker[] = [];
  private numPoints = 0;
  private total = 0;
  /** Points above this height are hidden from outside. */
  private section = Infinity;
  private standing: Place3 | null = null;
  private moved = 0;
  private frame = 0;
  private lastMoving = 0;
  private isTouched = true;
  private isAnew = true;
  private isFull = false;

  constructor(canvas: HTMLCanvasElement, colors: StageColors) {
    this.canvas = canvas;
    this.painter = makePainter(canvas, colors);
    this.camera.up.set(0, 0, 1);
    this.outside = new OutsideView(canvas, this.camera, () => this.touch());
    this.look = new LookAround(canvas, () => this.turned());
    this.clicks = new Clicks(canvas, (at, isByKey) => this.clicked(at, isByKey));
  }

  recolor(colors: StageColors): void {
    this.painter.recolor(colors);
    this.refresh();
  }

  /** Begin a scan of so many points; bounds: in the world of the renderer. */
  begin(numPoints: number, bounds: Bounds): void {
    [this.numPoints, this.total, this.outside.bounds] = [0, numPoints, bounds];
    this.painter.begin(numPoints);
    if (this.standing === null) this.leave();
    else this.outside.forget();
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
    if (this.standing === null) this.outside.hold();
    this.standing = place;
    this.painter.showPhoto(null);
    const isWhole = camera.hfov_deg > 300;
    const [yaw, pitch] = directionAngles(place.rotation);
    this.look.begin(yaw, pitch, isWhole ? null : place.rotation, isWhole ? INSIDE_FOV_DEG : this.fovOf(camera));
    if (isWhole) this.look.pitch = 0;
    this.turned();
    if (photo === null) return;
    const canvas = await decodePhoto(photo);
    if (this.standing !== place) return;
    this.painter.showPhoto({ canvas, camera, place });
    this.touch();
  }

  /** Go back outside, to where one looked from. */
  stepOut(): void {
    if (this.standing === null) return;
    this.standing = null;
    this.look.end();
    this.painter.showPhoto(null);
    this.outside.resume();
    this.touch();
  }

  /** Go outside, where the whole scan is seen; isPlan: from straight above. */
  leave(isPlan = this.outside.isPlan): void {
    this.stepOut();
    this.outside.isPlan = isPlan;
    this.outside.reset();
    this.touch();
  }

  /** Hide the points above a height from whoever is outside. */
  cutAt(height: number): void {
    this.section = height;
    if (this.standing === null) this.touch();
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

  /** Tell whether nothing of the scan lies between two places, in the world of the renderer. */
  sees(from: Vector3, to: Vector3): boolean {
    return isClear(this.painter.points, from, to);
  }

  /** Return where a place is seen, in pixels of the page from the upper left corner; null behind the viewer. */
  project(at: Vector3): [number, number] | null {
    const seen = new V3(...at).project(this.camera);
    return seen.z > 1 || seen.z < -1 ? null : [((seen.x + 1) / 2) * this.canvas.clientWidth, ((1 - seen.y) / 2) * this.canvas.clientHeight];
  }

  /** Which way is up on the screen, or ahead: counter-clockwise from +x, radians. */
  get heading(): number {
    const m = this.camera.matrixWorld.elements;
    return Math.atan2(m[5]! - m[9]!, m[4]! - m[8]!);
  }

  get metresPerPixel(): number {
    return this.outside.metresPerPixel(Math.max(1, this.canvas.clientHeight));
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
    this.outside.keys.turn((degrees / 180) * Math.PI, 0);
  }

  dispose(): void {
    cancelAnimationFrame(this.frame);
    this.outside.dispose();
    this.look.dispose();
    this.painter.dispose();
    this.clicks.dispose();
  }

  private get cut(): number {
    return this.standing === null ? this.section : Infinity;
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
    this.camera.far = 2 * this.outside.size + 10;
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
    if (this.standing === null) this.outside.fitDepths();
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
    this.onDraw();
  };

  private clicked(at: [number, number], isByKey: boolean): void {
    if (this.onPick) {
      const limits = { far: this.camera.position.distanceTo(this.outside.orbit.target) + 2 * this.outside.size, cut: this.cut };
      this.onPick(pickUnder(this.painter.points, this.camera, at, this.canvas.clientHeight, limits));
    } else if (!isByKey) {
      const marker = markerAt(this.markers, at, this.camera, this.camera.aspect);
      if (marker) this.onMarker(marker.index);
    }
  }
}
