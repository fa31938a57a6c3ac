/** A photo seen from its camera, pixel by pixel, without a graphics processor; `webgl_photo.ts` says the same in GLSL. */

import type { CameraOfImage } from "../../api/types.ts";
import { type Rotation, times, transposed } from "../frames.ts";
import type { PlacedPhoto } from "./painter.ts";

/** The pixels of a photo, (height * width,) bytes r, g, b, 255. */
export interface PhotoPixels {
  width: number;
  height: number;
  pixels: Uint32Array;
  camera: CameraOfImage;
  cameraFromMap: Rotation;
}

export function photoPixels({ canvas, camera, place }: PlacedPhoto): PhotoPixels {
  const { width, height } = canvas;
  const { data } = canvas.getContext("2d", { willReadFrequently: true })!.getImageData(0, 0, width, height);
  return { width, height, pixels: new Uint32Array(data.buffer), camera, cameraFromMap: transposed(place.rotation) };
}

/**
 * Write what a view of `columns` x `rows` pixels shows of a photo into `layer`; 0 where it shows none of it.
 * mapFromView: of a camera that looks along −z, its y up. tanHalf: of half the vertical angle of view.
 */
export function drawPhoto(layer: Uint32Array, columns: number, rows: number, photo: PhotoPixels, mapFromView: Rotation, tanHalf: number): void {
  const [forward, left, up] = times(photo.cameraFromMap, mapFromView);
  const sourceOf = SOURCES[photo.camera.model];
  const { width, height, pixels } = photo;
  const hfov = (photo.camera.hfov_deg * Math.PI) / 180;
  const isRound = hfov > 6.28;
  const vfov = (hfov * height) / width;
  const step = (2 * tanHalf) / rows;
  const at = new Float64Array(2);
  for (let row = 0, to = 0; row < rows; row += 1) {
    const v = tanHalf - (row + 0.5) * step;
    for (let column = 0; column < columns; column += 1, to += 1) {
      const u = (column + 0.5 - columns / 2) * step;
      const x = forward[0] * u + forward[1] * v - forward[2];
      const y = left[0] * u + left[1] * v - left[2];
      const z = up[0] * u + up[1] * v - up[2];
      sourceOf(at, x, y, z, hfov, vfov);
      let [across, down] = [at[0]!, at[1]!];
      if (isRound) across -= Math.floor(across);
      layer[to] = down >= 0 && down < 1 && across >= 0 && across < 1 ? pixels[Math.floor(down * height) * width + Math.floor(across * width)]! : 0;
    }
  }
}

/** Lay a photo's layer over a picture: so much of it, 0..1. */
export function blend(out: Uint32Array, picture: Uint32Array, layer: Uint32Array, share: number): void {
  const over = Math.round(256 * share);
  const under = 256 - over;
  for (let pixel = 0; pixel < out.length; pixel += 1) {
    const below = picture[pixel]!;
    const above = layer[pixel]!;
    if (above === 0) {
      out[pixel] = below;
      continue;
    }
    const redBlue = ((Math.imul(below & 0xff00ff, under) + Math.imul(above & 0xff00ff, over)) >>> 8) & 0xff00ff;
    const green = (((below & 0xff00) * under + (above & 0xff00) * over) >>> 8) & 0xff00;
    out[pixel] = 0xff000000 | redBlue | green;
  }
}

/** Write where a direction (x forward, y left, z up) is in a photo, 0..1 across and down, outside of that where it is not in it. */
type Source = (at: Float64Array, x: number, y: number, z: number, hfov: number, vfov: number) => void;

const pinhole: Source = (at, x, y, z, hfov, vfov) => {
  const across = 2 * Math.tan(hfov / 2);
  const scale = x > 0 ? 1 / (x * across) : Infinity;
  at[0] = 0.5 - y * scale;
  at[1] = 0.5 - (z * scale * hfov) / vfov;
};
const SOURCES: Record<CameraOfImage["model"], Source> = {
  equirectangular(at, x, y, z, hfov, vfov) {
    at[0] = 0.5 - Math.atan2(y, x) / hfov;
    at[1] = 0.5 - Math.asin(z / Math.sqrt(x * x + y * y + z * z)) / vfov;
  },
  pinhole,
  opencv: pinhole,
  opencv_fisheye(at, x, y, z, hfov, vfov) {
    const beside = Math.hypot(y, z);
    // Straight behind every direction is as far.
    const scale = beside > 1e-9 ? Math.atan2(beside, x) / beside : x > 0 ? 1 : Infinity;
    at[0] = 0.5 - (y * scale) / hfov;
    at[1] = 0.5 - (z * scale) / vfov;
  },
  cylindrical(at, x, y, z, hfov, vfov) {
    at[0] = 0.5 - Math.atan2(y, x) / hfov;
    at[1] = 0.5 - z / Math.max(1e-9, Math.hypot(x, y)) / vfov;
  },
};
