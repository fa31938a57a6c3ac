/** Draws without WebGL, by the processor: fewer points and pixels while something moves, then part by part until all points are in. */

import { Color, Matrix3, Matrix4 } from "three";

import type { SceneCell } from "../change_tint.ts";
import type { Rotation } from "../frames.ts";
import type { Marker } from "../markers.ts";
import type { PointChunk } from "../point_decoder.ts";
import { ScanPoints } from "../scan_points.ts";
import type { Painter, PlacedPhoto, StageColors, View } from "./painter.ts";
import { drawMarkers, drawStarts } from "./processor_markers.ts";
import { ProcessorPace } from "./processor_pace.ts";
import { blend, drawPhoto, photoPixels, type PhotoPixels } from "./processor_photo.ts";
import { clear, drawPoints, type Picture, pictureOf, type Projection } from "./processor_points.ts";

/** Points that are looked at before the clock is. */
const BLOCK = 16_384;
/** Milliseconds for a part of a picture that stays: a drag meanwhile begins at once. */
const STILL_MS = 24;
/** The first points of a picture are drawn wide and behind: they close the gaps between the others. */
const MOST_COARSE = 250_000;
const COARSE_SHARE = 0.3;
const HIDDEN = 0.998;

export class ProcessorPainter implements Painter {
  readonly name = "the processor, without WebGL";
  readonly isFadedQuickly = true;
  numDrawn = 0;
  private readonly canvas: HTMLCanvasElement;
  private readonly context: CanvasRenderingContext2D;
  private readonly pace = new ProcessorPace();
  points = new ScanPoints(0);
  private picture: Picture = pictureOf(1, 1);
  private output = new ImageData(1, 1);
  private layer = new Uint32Array(0);
  private photo: PhotoPixels | null = null;
  private share = 1;
  private markers: Marker[] = [];
  private starts: Float32Array = new Float32Array(0);
  private colors: StageColors;
  private size: [number, number] = [1, 1];
  /** Whether what was drawn before no longer holds. */
  private isStale = true;

  constructor(canvas: HTMLCanvasElement, context: CanvasRenderingContext2D, colors: StageColors) {
    this.canvas = canvas;
    this.context = context;
    this.colors = colors;
  }

  recolor(colors: StageColors): void {
    this.colors = colors;
    this.isStale = true;
  }

  begin(numPoints: number): void {
    this.points = new ScanPoints(numPoints);
    this.isStale = true;
  }

  grow(chunk: PointChunk): void {
    this.points.add(chunk);
  }

  tint(cells: SceneCell[], side: number): void {
    this.points.tint(cells, side);
    this.isStale = true;
  }

  showStarts(positions: Float32Array): void {
    this.starts = positions;
  }

  showMarkers(markers: Marker[]): void {
    this.markers = markers;
  }

  showPhoto(photo: PlacedPhoto | null): void {
    this.photo = photo && photoPixels(photo);
    this.isStale = true;
  }

  fade(share: number): void {
    this.share = share;
  }

  resize(width: number, height: number): void {
    this.size = [width, height];
  }

  drawMoving(view: View, milliseconds: number): void {
    if (milliseconds > 0) this.pace.note(milliseconds);
    this.clearPicture(view, this.pace.fineness);
    const count = Math.min(this.points.numPoints, this.pace.numPoints(this.picture.pixels.length));
    const coarse = Math.floor(COARSE_SHARE * count);
    if (!this.isCovered) {
      this.drawRange(view, 0, count, this.points.widthOf(count), 0);
      this.drawRange(view, 0, coarse, this.points.coarseWidthOf(coarse), this.points.coarseWidthOf(coarse));
    }
    this.numDrawn = count;
    this.put(view);
  }

  drawStill(view: View, isAnew: boolean): boolean {
    if (isAnew || this.isStale) {
      this.clearPicture(view, Math.min(2, window.devicePixelRatio));
      this.numDrawn = 0;
      this.isStale = false;
    }
    const coarse = Math.min(MOST_COARSE, Math.floor(COARSE_SHARE * this.points.total));
    const until = performance.now() + STILL_MS;
    while (this.numDrawn < this.points.numPoints && performance.now() < until) {
      const isCoarse = this.numDrawn < coarse;
      const last = Math.min(this.points.numPoints, this.numDrawn + BLOCK, isCoarse ? coarse : Infinity);
      const width = isCoarse ? this.points.coarseWidthOf(coarse) : this.points.widthOf(this.points.total);
      this.drawRange(view, this.numDrawn, last, width, isCoarse ? 0.9 * width : 0);
      this.numDrawn = last;
    }
    this.put(view);
    return this.numDrawn === this.points.numPoints;
  }

  dispose(): void {
    this.points = new ScanPoints(0);
  }

  /** Whether the photo hides all points. */
  private get isCovered(): boolean {
    return this.photo !== null && this.share > HIDDEN && this.photo.camera.hfov_deg > 359;
  }

  private clearPicture(view: View, fineness: number): void {
    const [width, height] = this.size.map((side) => Math.max(1, Math.round(side * fineness))) as [number, number];
    if (this.picture.width !== width || this.picture.height !== height) {
      this.picture = pictureOf(width, height);
      this.output = new ImageData(width, height);
      [this.canvas.width, this.canvas.height] = [width, height];
    }
    clear(this.picture, packed(this.colors.background));
    if (this.photo === null) return;
    if (this.layer.length !== width * height) this.layer = new Uint32Array(width * height);
    drawPhoto(this.layer, width, height, this.photo, rotationOf(view), tanHalfOf(view));
  }

  private drawRange(view: View, first: number, last: number, width: number, behind: number): void {
    const { camera, cut } = view;
    const clipFromScene = new Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse).elements;
    const projection: Projection = { clipFromScene, near: camera.near, cut, pixelsPerRadian: this.picture.height / (2 * tanHalfOf(view)) };
    let start = 0;
    for (const [index, { positions, colors }] of this.points.chunks.entries()) {
      const end = start + colors.length;
      const [from, to] = [Math.max(first, start), Math.min(last, end)];
      if (from < to) drawPoints(this.picture, projection, positions, this.points.colorsOf(index), from - start, to - start, width, behind);
      start = end;
    }
  }

  private put(view: View): void {
    const shown = new Uint32Array(this.output.data.buffer);
    if (this.photo && this.share > 0) blend(shown, this.picture.pixels, this.layer, this.share);
    else shown.set(this.picture.pixels);
    this.context.putImageData(this.output, 0, 0);
    drawStarts(this.context, this.starts, view.camera, this.colors.start, this.picture.width / this.size[0]);
    drawMarkers(this.context, this.markers, view.camera, view.isInside, this.colors);
  }
}

function tanHalfOf({ camera }: View): number {
  return Math.tan((camera.fov / 360) * Math.PI);
}

function rotationOf({ camera }: View): Rotation {
  const m = new Matrix3().setFromMatrix4(camera.matrixWorld).elements;
  return [[m[0]!, m[3]!, m[6]!], [m[1]!, m[4]!, m[7]!], [m[2]!, m[5]!, m[8]!]];
}

function packed(color: string): number {
  const value = new Color(color).getHex();
  return (0xff000000 | ((value & 255) << 16) | (value & 0xff00) | (value >> 16)) >>> 0;
}
