/** The scan as points of WebGL: one buffer per chunk, sent to the graphics processor once. */

import { BufferAttribute, BufferGeometry, GLSL3, Group, Points, ShaderMaterial } from "three";

import type { ScanPoints } from "../scan_points.ts";

const VERTEX = `
in vec4 color;
uniform float width, pixelsPerRadian, cut, coarseWidth;
uniform int numCoarse;
out vec3 shade;
void main() {
  vec4 seen = modelViewMatrix * vec4(position, 1.0);
  float away = max(0.05, length(seen.xyz));
  // The first points are a thinner sample of the same scan: drawn wide and a little behind, they close the gaps between the others.
  bool isCoarse = gl_VertexID < numCoarse;
  if (isCoarse) seen.xyz *= 1.0 + 0.9 * coarseWidth / away;
  gl_Position = position.z > cut ? vec4(2.0, 2.0, 2.0, 1.0) : projectionMatrix * seen;
  gl_PointSize = clamp((isCoarse ? coarseWidth : width) * pixelsPerRadian / away, 1.0, 64.0);
  shade = color.rgb;
}`;
const FRAGMENT = `
in vec3 shade;
out vec4 shown;
void main() { shown = vec4(shade, 1.0); }`;

type Chunk = Points<BufferGeometry, ShaderMaterial>;

export class WebglPoints {
  readonly object = new Group();
  private readonly points: ScanPoints;

  constructor(points: ScanPoints) {
    this.points = points;
    points.chunks.forEach((_, index) => this.grow(index));
  }

  /** Add a chunk that has come. */
  grow(index: number): void {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(this.points.chunks[index]!.positions, 3));
    geometry.setAttribute("color", colorsOf(this.points, index));
    const uniforms = { width: { value: 0.01 }, coarseWidth: { value: 0.03 }, pixelsPerRadian: { value: 500 }, cut: { value: Infinity }, numCoarse: { value: 0 } };
    const chunk = new Points(geometry, new ShaderMaterial({ glslVersion: GLSL3, vertexShader: VERTEX, fragmentShader: FRAGMENT, uniforms }));
    chunk.frustumCulled = false;
    this.object.add(chunk);
  }

  recolor(): void {
    this.chunks.forEach((chunk, index) => chunk.geometry.setAttribute("color", colorsOf(this.points, index)));
  }

  /** Draw the points from `first` to `last`, of which those before `numCoarse` lie behind as a coarse sample, as wide as so many have to be. */
  show(first: number, last: number, width: number, numCoarse: number, coarseWidth: number, pixelsPerRadian: number, cut: number): void {
    let start = 0;
    for (const chunk of this.chunks) {
      const end = start + chunk.geometry.getAttribute("position").count;
      const [from, to] = [Math.max(first, start), Math.min(last, end)];
      chunk.visible = to > from;
      chunk.geometry.setDrawRange(from - start, Math.max(0, to - from));
      const { uniforms } = chunk.material;
      uniforms["width"]!.value = width;
      uniforms["coarseWidth"]!.value = coarseWidth;
      uniforms["numCoarse"]!.value = numCoarse - start;
      uniforms["pixelsPerRadian"]!.value = pixelsPerRadian;
      uniforms["cut"]!.value = cut;
      start = end;
    }
  }

  dispose(): void {
    for (const chunk of this.chunks) {
      chunk.geometry.dispose();
      chunk.material.dispose();
    }
  }

  private get chunks(): Chunk[] {
    return this.object.children as Chunk[];
  }
}

function colorsOf(points: ScanPoints, index: number): BufferAttribute {
  return new BufferAttribute(new Uint8Array(points.colorsOf(index).buffer), 4, true);
}
