/** What draws a scene: WebGL where there is a graphics processor, else the processor itself (see `make_painter.ts`). */

import type { PerspectiveCamera } from "three";

import type { CameraOfImage } from "../../api/types.ts";
import type { SceneCell } from "../change_tint.ts";
import type { Place3 } from "../frames.ts";
import type { Marker } from "../markers.ts";
import type { PointChunk } from "../point_decoder.ts";
import type { ScanPoints } from "../scan_points.ts";

export interface StageColors {
  background: string;
  accent: string;
  unsure: string;
  start: string;
  rim: string;
}

/** A photo, decoded, and the camera that took it. */
export interface PlacedPhoto {
  canvas: HTMLCanvasElement;
  camera: CameraOfImage;
  place: Place3;
}

export interface View {
  camera: PerspectiveCamera;
  /** Whether somebody stands where a photo was taken. */
  isInside: boolean;
  /** Points above this height are hidden, in the world of the renderer; Infinity shows everything. */
  cut: number;
}

export interface Painter {
  /** What draws, for people and measurements. */
  readonly name: string;
  /** Points in the last picture. */
  readonly numDrawn: number;
  readonly points: ScanPoints;
  /** Whether the photo is laid over what is drawn: then fading it needs no points. */
  readonly isFadedQuickly: boolean;
  recolor(colors: StageColors): void;
  /** Begin a scan of so many points, none of which is there yet. */
  begin(numPoints: number): void;
  /** Add points; any number of them from the front is a fair sample of the scan. */
  grow(chunk: PointChunk): void;
  tint(cells: SceneCell[], side: number): void;
  /** Starts of the search, (n, 3) in the world of the renderer. */
  showStarts(positions: Float32Array): void;
  showMarkers(markers: Marker[]): void;
  showPhoto(photo: PlacedPhoto | null): void;
  /** Show so much of the photo (1) or of the points (0). */
  fade(share: number): void;
  /** In pixels of the page. */
  resize(width: number, height: number): void;
  /** Draw as much as a moving picture has time for; milliseconds: since the picture before it, 0 for the first. */
  drawMoving(view: View, milliseconds: number): void;
  /** Draw the next part of a picture that stays; return whether that was the last one. isAnew: what was drawn before no longer holds. */
  drawStill(view: View, isAnew: boolean): boolean;
  dispose(): void;
}
