/** Draws with WebGL: as many points as the graphics processor draws in time while something moves, all of them once it rests. */

import { Color, Scene, WebGLRenderer } from "three";

import type { SceneCell } from "../change_tint.ts";
import type { Marker } from "../markers.ts";
import type { PointChunk } from "../point_decoder.ts";
import { ScanPoints } from "../scan_points.ts";
import { rendererOf } from "./graphics.ts";
import type { Painter, PlacedPhoto, StageColors, View } from "./painter.ts";
import { WebglMarkers } from "./webgl_markers.ts";
import { Pace } from "./webgl_pace.ts";
import { WebglPhoto } from "./webgl_photo.ts";
import { WebglPoints } from "./webgl_points.ts";
import { WebglStarts } from "./webgl_starts.ts";

const MOST_COARSE = 1_000_000;

export class WebglPainter implements Painter {
  readonly name: string;
  readonly isFadedQuickly = false;
  numDrawn = 0;
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly pace = new Pace();
  private readonly markers = new WebglMarkers();
  private readonly starts = new WebglStarts();
  points = new ScanPoints(0);
  private cloud = new WebglPoints(this.points);
  private photo: WebglPhoto | null = null;
  private blend = 1;
  private colors: StageColors;
  private shown: Marker[] = [];
  private startPositions: Float32Array = new Float32Array(0);
  private isStale = true;

  constructor(canvas: HTMLCanvasElement, context: WebGL2RenderingContext, colors: StageColors) {
    // What is drawn stays, so that a still picture grows part by part.
    this.renderer = new WebGLRenderer({ canvas, context, preserveDrawingBuffer: true });
    this.renderer.autoClear = false;
    this.scene.add(this.markers.object, this.starts.object);
    this.colors = colors;
    this.name = `WebGL, ${rendererOf(context)}`;
    this.recolor(colors);
  }

  recolor(colors: StageColors): void {
    this.colors = colors;
    this.renderer.setClearColor(new Color(colors.background));
    this.showMarkers(this.shown);
    this.showStarts(this.startPositions);
  }

  begin(numPoints: number): void {
    this.scene.remove(this.cloud.object);
    this.cloud.dispose();
    this.points = new ScanPoints(numPoints);
    this.cloud = new WebglPoints(this.points);
    this.scene.add(this.cloud.object);
    this.isStale = true;
  }

  grow(chunk: PointChunk): void {
    this.points.add(chunk);
    this.cloud.grow(this.points.chunks.length - 1);
  }

  tint(cells: SceneCell[], side: number): void {
    this.points.tint(cells, side);
    this.cloud.recolor();
    this.isStale = true;
  }

  showStarts(positions: Float32Array): void {
    this.startPositions = positions;
    this.starts.show(positions, this.colors.start);
    this.isStale = true;
  }

  showMarkers(markers: Marker[]): void {
    this.shown = markers;
    this.markers.show(markers, this.colors);
    this.isStale = true;
  }

  showPhoto(photo: PlacedPhoto | null): void {
    if (this.photo) {
      this.scene.remove(this.photo.object);
      this.photo.dispose();
    }
    this.photo = photo && new WebglPhoto(photo);
    if (this.photo) this.scene.add(this.photo.object);
    this.fade(this.blend);
  }

  fade(share: number): void {
    this.blend = share;
    if (this.photo) this.photo.opacity = share;
    this.isStale = true;
  }

  resize(width: number, height: number): void {
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
  }

  drawMoving(view: View, milliseconds: number): void {
    if (milliseconds > 0 && this.numDrawn > 0) this.pace.note(this.numDrawn, milliseconds);
    const count = Math.min(this.points.numPoints, this.pace.moving);
    this.draw(view, 0, count, count, true);
  }

  drawStill(view: View, isAnew: boolean): boolean {
    // A photo that shines through would be laid over itself by every part.
    const isWhole = this.photo?.object.visible === true;
    const isFirst = isAnew || this.isStale || isWhole;
    const first = isFirst ? 0 : this.numDrawn;
    const most = isWhole ? Infinity : this.pace.still;
    const last = Math.min(this.points.numPoints, first + most);
    this.draw(view, first, last, this.points.total, isFirst);
    this.isStale = false;
    return last === this.points.numPoints;
  }

  dispose(): void {
    this.cloud.dispose();
    this.showPhoto(null);
    this.renderer.dispose();
  }

  /** Draw a part of the points, as wide as `count` of them have to be. */
  private draw({ camera, isInside, cut }: View, first: number, last: number, count: number, isAnew: boolean): void {
    const tanHalf = Math.tan((camera.fov / 360) * Math.PI);
    const numCoarse = Math.min(MOST_COARSE, Math.floor(0.3 * count));
    const pixelsPerRadian = this.renderer.domElement.height / (2 * tanHalf);
    this.cloud.show(first, last, this.points.widthOf(count), numCoarse, this.points.coarseWidthOf(numCoarse), pixelsPerRadian, cut);
    this.markers.scaleTo(camera, tanHalf, isInside);
    if (isAnew) this.renderer.clear();
    this.renderer.render(this.scene, camera);
    this.numDrawn = last;
  }
}
