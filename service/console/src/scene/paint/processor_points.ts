/**
 * Draws points into a picture, without a graphics processor.
 *
 * Where there is none, WebGL is computed by the processor too, at 2 microseconds a point whatever its size; this takes a twentieth of that.
 */

export interface Picture {
  width: number;
  height: number;
  /** (height * width,) bytes r, g, b, 255. */
  pixels: Uint32Array;
  /** (height * width,) metres before the camera. */
  depths: Float32Array;
}

export interface Projection {
  /** 4 x 4, column by column: from the scene to clip space, the fourth component being metres before the camera. */
  clipFromScene: readonly number[];
  near: number;
  /** Points above this height are left out. */
  cut: number;
  pixelsPerRadian: number;
}

const LARGEST_PX = 40;

export function pictureOf(width: number, height: number): Picture {
  return { width, height, pixels: new Uint32Array(width * height), depths: new Float32Array(width * height) };
}

export function clear(picture: Picture, color: number): void {
  picture.pixels.fill(color);
  picture.depths.fill(Infinity);
}

/** Draw the points from `first` to `last` as squares of `width` metres; behind: metres that they are moved away, to show through gaps alone. */
export function drawPoints(picture: Picture, by: Projection, positions: Float32Array, colors: Uint32Array, first: number, last: number, width: number, behind: number): void {
  const { width: columns, height: rows, pixels, depths } = picture;
  const m = by.clipFromScene;
  const [ax, bx, cx, dx] = [m[0]!, m[4]!, m[8]!, m[12]!];
  const [ay, by_, cy, dy] = [m[1]!, m[5]!, m[9]!, m[13]!];
  const [aw, bw, cw, dw] = [m[3]!, m[7]!, m[11]!, m[15]!];
  const { near, cut } = by;
  const [halfColumns, halfRows] = [columns / 2, rows / 2];
  const scale = width * by.pixelsPerRadian;
  for (let point = first, at = 3 * first; point < last; point += 1, at += 3) {
    const x = positions[at]!;
    const y = positions[at + 1]!;
    const z = positions[at + 2]!;
    const away = aw * x + bw * y + cw * z + dw;
    if (away < near || z > cut) continue;
    const perAway = 1 / away;
    const size = Math.min(LARGEST_PX, (scale * perAway + 0.5) | 0);
    const half = size > 1 ? 0.5 * size - 0.5 : 0;
    const column = halfColumns + halfColumns * (ax * x + bx * y + cx * z + dx) * perAway - half;
    const row = halfRows - halfRows * (ay * x + by_ * y + cy * z + dy) * perAway - half;
    if (column < -size || row < -size || column >= columns || row >= rows) continue;
    const color = colors[point]!;
    const depth = away + behind;
    if (size <= 1) {
      if (column < 0 || row < 0) continue;
      const pixel = (row | 0) * columns + (column | 0);
      if (depth < depths[pixel]!) {
        depths[pixel] = depth;
        pixels[pixel] = color;
      }
      continue;
    }
    const left = column < 0 ? 0 : column | 0;
    const top = row < 0 ? 0 : row | 0;
    const right = Math.min(columns, ((column + columns) | 0) - columns + size);
    const bottom = Math.min(rows, ((row + rows) | 0) - rows + size);
    for (let line = top; line < bottom; line += 1) {
      for (let pixel = line * columns + left, end = line * columns + right; pixel < end; pixel += 1) {
        if (depth < depths[pixel]!) {
          depths[pixel] = depth;
          pixels[pixel] = color;
        }
      }
    }
  }
}
