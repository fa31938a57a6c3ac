/** Paints photos around the eye: with WebGL, or by the processor where a browser has none. */

import type { Vector3 } from "../api/types.ts";
import type { Rotation } from "../scene/frames.ts";
import type { PlacedPhoto } from "../scene/paint/painter.ts";
import { blend, drawPhoto, type PhotoPixels, photoPixels } from "../scene/paint/processor_photo.ts";
import { WebglSphere } from "./webgl_sphere.ts";

/** A photo in the picture. shift: of the eye from where it was taken, as a share of the sphere that the photo is on. */
export interface Layer {
  photo: PlacedPhoto;
  opacity: number;
  shift: Vector3;
}

export interface WalkView {
  /** Of a camera that looks along −z, its y up. */
  mapFromView: Rotation;
  /** Of half the vertical angle of view. */
  tanHalf: number;
}

export interface WalkPainter {
  /** Pixels across that a photo may have. */
  readonly mostPixels: number;
  /** In pixels of the page. */
  resize(width: number, height: number): void;
  /** Draw layers, the last on top. */
  draw(layers: readonly Layer[], view: WalkView): void;
}

/** Phones have little memory: a photo of 8192 pixels takes 134 MB of it. */
const MOST_ON_PHONES = 4096;
const MOST_BY_PROCESSOR = 2048;

export function makeWalkPainter(canvas: HTMLCanvasElement): WalkPainter {
  const context = canvas.getContext("webgl2", { antialias: false, alpha: false });
  if (context === null) return new ProcessorSphere(canvas.getContext("2d", { alpha: false })!);
  const isPhone = window.matchMedia("(pointer: coarse)").matches;
  return new WebglSphere(context, isPhone ? MOST_ON_PHONES : Infinity);
}

class ProcessorSphere implements WalkPainter {
  readonly mostPixels = MOST_BY_PROCESSOR;
  private readonly context: CanvasRenderingContext2D;
  private readonly known = new WeakMap<PlacedPhoto, PhotoPixels>();

  constructor(context: CanvasRenderingContext2D) {
    this.context = context;
  }

  resize(width: number, height: number): void {
    // Half the pixels each way: turning stays smooth.
    this.context.canvas.width = Math.max(1, Math.round(width / 2));
    this.context.canvas.height = Math.max(1, Math.round(height / 2));
  }

  draw(layers: readonly Layer[], { mapFromView, tanHalf }: WalkView): void {
    const { width, height } = this.context.canvas;
    const output = this.context.createImageData(width, height);
    const shown = new Uint32Array(output.data.buffer);
    const layer = new Uint32Array(shown.length);
    for (const { photo, opacity } of layers) {
      const pixels = this.known.get(photo) ?? photoPixels(photo);
      this.known.set(photo, pixels);
      drawPhoto(layer, width, height, pixels, mapFromView, tanHalf);
      blend(shown, shown, layer, opacity);
    }
    this.context.putImageData(output, 0, 0);
  }
}
