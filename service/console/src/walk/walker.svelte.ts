/** Where somebody stands in the walk-through and what is drawn there: steps from photo to photo, with the heading kept. */

import type { Vector3 } from "../api/types.ts";
import { directionAngles, levelRotation, type Rotation, viewRotation } from "../scene/frames.ts";
import { LookAround } from "../scene/look_around.ts";
import type { PlacedPhoto } from "../scene/paint/painter.ts";
import { PhotoFiles } from "./photo_files.ts";
import type { WalkData, WalkPhoto } from "./walk_data.ts";
import { type Layer, makeWalkPainter, type WalkPainter, type WalkView } from "./walk_painter.ts";

const STEP_MS = 480;
/** Of the sphere's radius: how far the eye moves between two photos before one is the other. */
const STEP_SHARE = 0.32;
const SPHERE_FOV_DEG = 75;
/** Radians: a little down, so that the arrow on the floor is seen. */
const FIRST_PITCH = -0.3;
const [NARROWEST_FOV_DEG, WIDEST_FOV_DEG] = [30, 100];
const NO_SHIFT: Vector3 = [0, 0, 0];

export class Walker {
  /** Number of the photo, -1 before the first has come. */
  here = $state(-1);
  /** How one looks: from camera (x forward, y left, z up) to map; its yaw counter-clockwise from +x, radians. */
  rotation = $state.raw<Rotation>(levelRotation(0, 0));
  yaw = $state(0);
  fovDeg = $state(SPHERE_FOV_DEG);
  fault = $state("");
  isLoading = $state(false);
  private readonly data: WalkData;
  private readonly canvas: HTMLCanvasElement;
  private readonly painter: WalkPainter;
  private readonly files: PhotoFiles;
  private readonly look: LookAround;
  private photo: PlacedPhoto | null = null;
  private layers: Layer[] = [];
  private wanted = -1;
  private frame = 0;

  constructor(canvas: HTMLCanvasElement, data: WalkData) {
    [this.canvas, this.data] = [canvas, data];
    this.painter = makeWalkPainter(canvas);
    this.files = new PhotoFiles(this.painter.mostPixels);
    this.look = new LookAround(canvas, () => this.turned());
  }

  resize(width: number, height: number): void {
    this.painter.resize(width, height);
    this.draw();
  }

  get view(): WalkView {
    return { mapFromView: viewRotation(this.look.rotation), tanHalf: Math.tan((this.look.fovDeg / 360) * Math.PI) };
  }

  /** Turn the head. yaw: counter-clockwise from +x, radians. */
  turnTo(yaw: number, pitch: number): void {
    this.look.begin(yaw, pitch, null, this.look.fovDeg);
    this.turned();
  }

  /** Walk to a photo; whoever asks for another one meanwhile gets that. */
  async go(number: number): Promise<void> {
    const to = this.data.photos[number];
    if (to === undefined || number === this.wanted) return;
    this.wanted = number;
    this.isLoading = true;
    try {
      const canvas = await this.files.medium(number);
      if (this.wanted !== number) return;
      const photo = placed(to, canvas);
      this.face(to, photo);
      const from = this.photo;
      [this.photo, this.here, this.fault] = [photo, number, ""];
      await this.step(from, photo);
      if (this.wanted !== number) return;
      this.isLoading = false;
      if (to.hasLarge && this.painter.mostPixels > canvas.width) await this.sharpen(number, to);
    } catch (error) {
      this.fault = error instanceof Error ? error.message : String(error);
      this.isLoading = false;
      this.wanted = this.here;
    }
    // What may be next is there before it is asked for.
    for (const link of to.links) if (this.wanted === number) await this.files.medium(link).catch(() => undefined);
  }

  dispose(): void {
    cancelAnimationFrame(this.frame);
    this.look.dispose();
  }

  /** Keep the heading; a photo with edges is looked at as it was taken, the first sphere to where one can walk. */
  private face(to: WalkPhoto, photo: PlacedPhoto): void {
    const wasWhole = this.photo !== null && isWhole(this.photo);
    const [yaw, pitch] = directionAngles(to.rotation);
    if (!isWhole(photo)) this.look.begin(yaw, pitch, to.rotation, this.fovOf(photo));
    else if (this.photo === null) this.look.begin(this.wayOn(to) ?? yaw, FIRST_PITCH, null, SPHERE_FOV_DEG);
    else this.look.begin(this.look.yaw, wasWhole ? this.look.pitch : 0, null, wasWhole ? this.look.fovDeg : SPHERE_FOV_DEG);
    this.turned();
  }

  /** Return the heading to the nearest photo that is seen from one; undefined where none is. */
  private wayOn(from: WalkPhoto): number | undefined {
    const to = this.data.photos[from.links[0] ?? -1];
    return to && Math.atan2(to.position[1] - from.position[1], to.position[0] - from.position[0]);
  }

  /** Move from one photo to the next: the eye goes ahead while the one fades into the other. */
  private async step(from: PlacedPhoto | null, to: PlacedPhoto): Promise<void> {
    const isQuick = from === null || window.matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (!isQuick) {
      const ahead = directionOf(from.place.position, to.place.position);
      const began = performance.now();
      for (let share = 0; share < 1 && this.photo === to; share = (performance.now() - began) / STEP_MS) {
        const eased = share * share * (3 - 2 * share);
        this.layers = [
          { photo: from, opacity: 1, shift: scaled(ahead, STEP_SHARE * eased) },
          { photo: to, opacity: eased, shift: scaled(ahead, STEP_SHARE * (eased - 1)) },
        ];
        this.draw();
        await new Promise((resolve) => requestAnimationFrame(resolve));
      }
    }
    if (this.photo === to) this.show(to);
  }

  private async sharpen(number: number, to: WalkPhoto): Promise<void> {
    const photo = placed(to, await this.files.large(number));
    if (this.wanted !== number) return;
    this.photo = photo;
    this.show(photo);
  }

  private show(photo: PlacedPhoto): void {
    this.layers = [{ photo, opacity: 1, shift: NO_SHIFT }];
    this.draw();
  }

  private turned(): void {
    this.rotation = this.look.rotation;
    this.yaw = directionAngles(this.rotation)[0];
    this.fovDeg = this.look.fovDeg;
    this.draw();
  }

  private draw(): void {
    if (this.frame !== 0) return;
    this.frame = requestAnimationFrame(() => {
      this.frame = 0;
      this.painter.draw(this.layers, this.view);
    });
  }

  /** All of a photo with edges, with a little around it. */
  private fovOf({ camera, canvas }: PlacedPhoto): number {
    const across = Math.tan((Math.min(camera.hfov_deg, 110) / 360) * Math.PI);
    const { clientWidth, clientHeight } = this.canvas;
    const tanHalf = 1.12 * Math.max(across * (canvas.height / canvas.width), (across * clientHeight) / Math.max(1, clientWidth));
    return Math.max(NARROWEST_FOV_DEG, Math.min(WIDEST_FOV_DEG, (Math.atan(tanHalf) / Math.PI) * 360));
  }
}

function placed(photo: WalkPhoto, canvas: HTMLCanvasElement): PlacedPhoto {
  return { canvas, camera: { model: photo.model, hfov_deg: photo.hfovDeg }, place: { position: photo.position, rotation: photo.rotation } };
}

function isWhole(photo: PlacedPhoto): boolean {
  return photo.camera.hfov_deg > 300;
}

function directionOf(from: Vector3, to: Vector3): Vector3 {
  const ahead = to.map((value, axis) => value - from[axis]!) as Vector3;
  return scaled(ahead, 1 / Math.max(1e-6, Math.hypot(...ahead)));
}

function scaled(vector: Vector3, factor: number): Vector3 {
  return vector.map((value) => value * factor) as Vector3;
}
