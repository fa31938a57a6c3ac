/** The 3D view: the scan from outside, turned about its middle, or from where a photo was taken, with the photo in front of the points. */

import { Color, Matrix4, PerspectiveCamera, Scene, Vector3 as V3, WebGLRenderer } from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";

import type { CameraOfImage, Vector3 } from "../api/types.ts";
import type { SceneCell } from "./change_tint.ts";
import { CameraMarkers, type Marker } from "./camera_markers.ts";
import { directionAngles, type Place3, viewRotation } from "./frames.ts";
import { LookAround } from "./look_around.ts";
import { Pace } from "./pace.ts";
import { photoTexture, PhotoSurface } from "./photo_surface.ts";
import { PointCloud } from "./point_cloud.ts";
import type { PointArrays } from "./point_decoder.ts";

const OUTSIDE_FOV_DEG = 45;
const INSIDE_FOV_DEG = 75;
/** Of the scan's height that is shown from outside: ceilings hide what is below them. */
const SHOWN_HEIGHT = 0.82;
const STILL_AFTER_MS = 180;

export interface StageColors {
  background: string;
  accent: string;
  unsure: string;
  rim: string;
}

export class Stage {
  readonly pace = new Pace();
  onMarker: (index: number) => void = () => undefined;
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(OUTSIDE_FOV_DEG, 1, 0.05, 5000);
  private readonly orbit: OrbitControls;
  private readonly look: LookAround;
  private readonly markers = new CameraMarkers();
  private readonly canvas: HTMLCanvasElement;
  private cloud: PointCloud | null = null;
  private photo: PhotoSurface | null = null;
  private changes: { cells: SceneCell[]; side: number } = { cells: [], side: 0 };
  private standing: Place3 | null = null;
  private bounds: { min: Vector3; max: Vector3 } = { min: [-1, -1, -1], max: [1, 1, 1] };
  private colors: StageColors;
  private blend = 1;
  private moved = 0;
  private drawn = 0;
  private frame = 0;
  private lastFrame = 0;
  private isFull = false;
  private pressed: [number, number] | null = null;

  constructor(canvas: HTMLCanvasElement, colors: StageColors) {
    this.canvas = canvas;
    this.colors = colors;
    this.renderer = new WebGLRenderer({ canvas, antialias: false, alpha: false, powerPreference: "high-performance", preserveDrawingBuffer: true });
    this.camera.up.set(0, 0, 1);
    this.orbit = new OrbitControls(this.camera, canvas);
    this.orbit.addEventListener("change", () => this.touch());
    this.orbit.listenToKeyEvents(canvas);
    this.orbit.maxPolarAngle = Math.PI * 0.98;
    this.look = new LookAround(canvas, () => this.turned());
    this.scene.add(this.markers.object);
    canvas.addEventListener("pointerdown", this.down);
    canvas.addEventListener("pointerup", this.up);
    this.recolor(colors);
  }

  recolor(colors: StageColors): void {
    this.colors = colors;
    this.scene.background = new Color(colors.background);
    this.touch();
  }

  /** Begin a scan; bounds: in the world of the renderer. */
  setCloud(arrays: PointArrays, bounds: { min: Vector3; max: Vector3 }): void {
    this.dropCloud();
    this.cloud = new PointCloud(arrays);
    this.cloud.tint(this.changes.cells, this.changes.side);
    this.scene.add(this.cloud.object);
    this.bounds = bounds;
    if (this.standing === null) this.leave();
  }

  grow(numPoints: number): void {
    this.cloud?.grow(numPoints);
    this.touch();
  }

  show(markers: Marker[]): void {
    this.markers.show(markers, this.colors);
    this.touch();
  }

  /** Tint the points in cells of space in which something changed. */
  tint(cells: SceneCell[], side: number): void {
    this.changes = { cells, side };
    this.cloud?.tint(cells, side);
    this.touch();
  }

  /** Stand where a photo was taken, with the photo before the points where there is one. */
  async stand(place: Place3, photo: Blob | null, camera: CameraOfImage): Promise<void> {
    this.standing = place;
    this.orbit.enabled = false;
    this.removePhoto();
    const isWhole = camera.hfov_deg > 300;
    const [yaw, pitch] = directionAngles(place.rotation);
    this.look.begin(yaw, pitch, isWhole ? null : place.rotation, isWhole ? INSIDE_FOV_DEG : this.fovOf(camera));
    if (isWhole) this.look.pitch = 0;
    if (this.cloud) this.cloud.cut = Infinity;
    this.turned();
    if (photo === null) return;
    const texture = await photoTexture(photo);
    if (this.standing !== place) {
      texture.dispose();
      return;
    }
    this.removePhoto();
    this.photo = new PhotoSurface(texture, camera, place);
    this.photo.opacity = this.blend;
    this.scene.add(this.photo.object);
    this.touch();
  }

  /** Go back outside. */
  leave(): void {
    this.standing = null;
    this.look.end();
    this.removePhoto();
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
    if (this.cloud) this.cloud.cut = min[2] + SHOWN_HEIGHT * (max[2] - min[2]);
    this.touch();
  }

  /** Show so much of the photo (1) or of the points (0). */
  fade(share: number): void {
    this.blend = share;
    if (this.photo) this.photo.opacity = share;
    this.touch();
  }

  resize(width: number, height: number): void {
    if (width < 1 || height < 1) return;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.touch();
  }

  /** What a test or a measurement asks: where one stands, what was drawn, and with what. */
  state(): { numDrawn: number; numPoints: number; framesPerSecond: number; isStill: boolean; isStanding: boolean; renderer: string } {
    const gl = this.renderer.getContext();
    const named = gl.getExtension("WEBGL_debug_renderer_info");
    return {
      numDrawn: this.drawn,
      numPoints: this.cloud?.numPoints ?? 0,
      framesPerSecond: this.pace.framesPerSecond,
      isStill: this.frame === 0 && this.isFull,
      isStanding: this.standing !== null,
      renderer: String(named ? gl.getParameter(named.UNMASKED_RENDERER_WEBGL) : "unknown"),
    };
  }

  /** Turn about the middle by so many degrees, as dragging does. */
  spin(degrees: number): void {
    const [x, y] = [this.camera.position.x - this.orbit.target.x, this.camera.position.y - this.orbit.target.y];
    const [c, s] = [Math.cos((degrees / 180) * Math.PI), Math.sin((degrees / 180) * Math.PI)];
    this.camera.position.x = this.orbit.target.x + c * x - s * y;
    this.camera.position.y = this.orbit.target.y + s * x + c * y;
    this.orbit.update();
    this.touch();
  }

  dispose(): void {
    cancelAnimationFrame(this.frame);
    this.look.dispose();
    this.orbit.dispose();
    this.dropCloud();
    this.removePhoto();
    this.canvas.removeEventListener("pointerdown", this.down);
    this.canvas.removeEventListener("pointerup", this.up);
    this.renderer.dispose();
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
    this.touch();
  }

  /** Something changed: draw quickly now, and fully once nothing has changed for a moment. */
  private touch(): void {
    this.moved = performance.now();
    this.isFull = false;
    if (this.frame === 0) {
      this.lastFrame = 0;
      this.frame = requestAnimationFrame(this.draw);
    }
  }

  private readonly draw = (now: number): void => {
    // While points come, pictures are quick ones: a full one would hold the stream up.
    const isStill = performance.now() - this.moved > STILL_AFTER_MS && (this.cloud?.isComplete ?? true);
    if (this.lastFrame > 0 && this.drawn > 0 && !document.hidden && !isStill) this.pace.note(this.drawn, now - this.lastFrame);
    this.lastFrame = now;
    const tanHalf = Math.tan((this.camera.fov / 360) * Math.PI);
    const pixelsPerRadian = this.renderer.domElement.height / (2 * tanHalf);
    if (this.cloud) this.drawn = this.cloud.show(isStill ? this.pace.still : this.pace.moving, pixelsPerRadian, !isStill && this.pace.isSlow);
    this.markers.scaleTo(this.camera, tanHalf, this.standing !== null);
    this.renderer.render(this.scene, this.camera);
    this.isFull = isStill;
    const isWaiting = !isStill && performance.now() - this.moved > STILL_AFTER_MS;
    this.frame = isStill || isWaiting ? 0 : requestAnimationFrame(this.draw);
  };

  private readonly down = (event: PointerEvent): void => {
    this.pressed = [event.clientX, event.clientY];
  };

  private readonly up = (event: PointerEvent): void => {
    if (this.pressed === null) return;
    const box = this.canvas.getBoundingClientRect();
    const wasClick = Math.hypot(event.clientX - this.pressed[0], event.clientY - this.pressed[1]) < 5;
    const at: [number, number] = [((event.clientX - box.left) / box.width) * 2 - 1, 1 - ((event.clientY - box.top) / box.height) * 2];
    const marker = wasClick ? this.markers.at(at, this.camera, this.camera.aspect) : null;
    if (marker) this.onMarker(marker.index);
  };

  private dropCloud(): void {
    if (this.cloud === null) return;
    this.scene.remove(this.cloud.object);
    this.cloud.dispose();
    this.cloud = null;
  }

  private removePhoto(): void {
    if (this.photo === null) return;
    this.scene.remove(this.photo.object);
    this.photo.dispose();
    this.photo = null;
  }
}
