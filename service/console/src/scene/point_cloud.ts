/** The scan as points. Any number of them from the front is a fair sample, so that fewer are drawn where time is short. */

import { BufferAttribute, BufferGeometry, GLSL3, Points, ShaderMaterial, Sphere, Vector3 as V3 } from "three";

import { type SceneCell, tintPoints } from "./change_tint.ts";
import type { PointArrays } from "./point_decoder.ts";

const VERTEX = `
in vec3 color;
in float tint;
uniform float spacing, pixelsPerRadian, cut, largest;
uniform int numCoarse;
uniform bool anyTint;
out vec3 shade;
void main() {
  vec4 seen = modelViewMatrix * vec4(position, 1.0);
  float away = max(0.05, length(seen.xyz));
  // The first points are a thinner sample of the same scan: drawn wide and a little behind, they close the gaps between the others.
  float width = gl_VertexID < numCoarse ? 3.0 * spacing : spacing;
  if (gl_VertexID < numCoarse) seen.xyz *= 1.0 + 2.5 * spacing / away;
  gl_Position = position.z > cut ? vec4(2.0, 2.0, 2.0, 1.0) : projectionMatrix * seen;
  gl_PointSize = clamp(width * pixelsPerRadian / away, 1.0, largest);
  float grey = dot(color, vec3(0.3, 0.59, 0.11));
  shade = anyTint ? mix(mix(color, vec3(grey), 0.55), vec3(0.88, 0.17, 0.14), 0.85 * tint) : color;
}`;
const FRAGMENT = `
in vec3 shade;
out vec4 shown;
void main() { shown = vec4(shade, 1.0); }`;
const SAMPLED = 20_000;
const CELLS_ACROSS = 64;
/** A point is drawn somewhat wider than its distance to the next, so that surfaces close. */
const OVERLAP = 1.5;
const COARSE_SHARE = 0.3;
const LARGEST_PX = 64;
const LARGEST_WHEN_SLOW_PX = 4;

export class PointCloud {
  readonly object: Points<BufferGeometry, ShaderMaterial>;
  private readonly positions: BufferAttribute;
  private readonly colors: BufferAttribute;
  private readonly tints: BufferAttribute;
  private readonly arrays: PointArrays;
  private changes: { cells: SceneCell[]; side: number } = { cells: [], side: 0 };
  private numArrived = 0;
  private areaM2 = 0;

  constructor(arrays: PointArrays) {
    this.arrays = arrays;
    this.positions = new BufferAttribute(arrays.positions, 3);
    this.colors = new BufferAttribute(arrays.colors, 3, true);
    this.tints = new BufferAttribute(new Uint8Array(arrays.positions.length / 3), 1, true);
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", this.positions);
    geometry.setAttribute("color", this.colors);
    geometry.setAttribute("tint", this.tints);
    geometry.boundingSphere = new Sphere(new V3(), Infinity);
    geometry.setDrawRange(0, 0);
    const uniforms = { spacing: { value: 0.01 }, pixelsPerRadian: { value: 500 }, cut: { value: Infinity }, largest: { value: LARGEST_PX }, numCoarse: { value: 0 }, anyTint: { value: false } };
    const material = new ShaderMaterial({ glslVersion: GLSL3, vertexShader: VERTEX, fragmentShader: FRAGMENT, uniforms });
    this.object = new Points(geometry, material);
    this.object.frustumCulled = false;
  }

  get numPoints(): number {
    return this.numArrived;
  }

  /** Whether all points are there. */
  get isComplete(): boolean {
    return 3 * this.numArrived === this.arrays.positions.length;
  }

  /** Say that the first `numArrived` points are in the arrays now. */
  grow(numArrived: number): void {
    const first = this.numArrived;
    this.numArrived = numArrived;
    for (const attribute of [this.positions, this.colors]) {
      attribute.addUpdateRange(3 * first, 3 * (numArrived - first));
      attribute.needsUpdate = true;
    }
    if (this.changes.cells.length) this.retint(first);
    if (first < SAMPLED) this.areaM2 = surfaceOf(this.arrays.positions, Math.min(numArrived, SAMPLED));
  }

  /** Tint points in cells in which something changed, and grey the others; without cells all have their own colours. */
  tint(cells: SceneCell[], side: number): void {
    this.changes = { cells, side };
    this.object.material.uniforms["anyTint"]!.value = cells.length > 0;
    if (cells.length) this.retint(0);
  }

  /**
   * Draw at most `most` points from now on, as large as it takes for so many to close surfaces; return how many that are.
   * isSlow: leave gaps instead, because pixels cost more than points where a processor draws them.
   */
  show(most: number, pixelsPerRadian: number, isSlow = false): number {
    const count = Math.min(this.numArrived, Math.max(1, Math.floor(most)));
    this.object.geometry.setDrawRange(0, count);
    const { spacing, pixelsPerRadian: scale, numCoarse, largest } = this.object.material.uniforms;
    numCoarse!.value = isSlow ? 0 : Math.floor(COARSE_SHARE * count);
    largest!.value = isSlow ? LARGEST_WHEN_SLOW_PX : LARGEST_PX;
    spacing!.value = OVERLAP * Math.sqrt(this.areaM2 / Math.max(1, count));
    scale!.value = pixelsPerRadian;
    return count;
  }

  /** Hide what lies above a height; Infinity shows everything. */
  set cut(height: number) {
    this.object.material.uniforms["cut"]!.value = height;
  }

  private retint(first: number): void {
    tintPoints(this.tints.array as Uint8Array, this.arrays.positions, first, this.numArrived, this.changes.cells, this.changes.side);
    this.tints.addUpdateRange(first, this.numArrived - first);
    this.tints.needsUpdate = true;
  }

  dispose(): void {
    this.object.geometry.dispose();
    this.object.material.dispose();
  }
}

/** Estimate the area of a scan's surfaces: cells of a coarse grid that hold points, each about one cell's side wide. */
function surfaceOf(positions: Float32Array, count: number): number {
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (let at = 0; at < 3 * count; at += 1) {
    low[at % 3] = Math.min(low[at % 3]!, positions[at]!);
    high[at % 3] = Math.max(high[at % 3]!, positions[at]!);
  }
  const side = Math.max(...high.map((value, axis) => value - low[axis]!), 1e-3) / CELLS_ACROSS;
  const cells = new Set<number>();
  for (let at = 0; at < 3 * count; at += 3) {
    const [x, y, z] = [0, 1, 2].map((axis) => Math.floor((positions[at + axis]! - low[axis]!) / side)) as [number, number, number];
    cells.add((x * 128 + y) * 128 + z);
  }
  return Math.max(cells.size * side * side, 1e-6);
}
