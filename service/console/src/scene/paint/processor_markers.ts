/** Cameras and starts drawn over a finished picture: dots, and arrows the way cameras looked. */

import { type PerspectiveCamera, Vector3 as V3 } from "three";

import type { Vector3 } from "../../api/types.ts";
import { applied } from "../frames.ts";
import { MARKER_SIZE, type Marker, NEAREST_M } from "../markers.ts";
import type { StageColors } from "./painter.ts";

const START_PX = 2.5;
const NOWHERE: Vector3 = [0, 0, 0];

/** Draw starts, (n, 3) in the world of the renderer; scale: pixels of the canvas per pixel of the page. */
export function drawStarts(context: CanvasRenderingContext2D, positions: Float32Array, camera: PerspectiveCamera, color: string, scale: number): void {
  const { width, height } = context.canvas;
  const at = new V3();
  context.fillStyle = color;
  context.globalAlpha = 0.85;
  context.beginPath();
  for (let start = 0; start < positions.length; start += 3) {
    at.set(positions[start]!, positions[start + 1]!, positions[start + 2]!).project(camera);
    if (at.z > 1) continue;
    const [x, y] = [((at.x + 1) / 2) * width, ((1 - at.y) / 2) * height];
    context.moveTo(x + START_PX * scale, y);
    context.arc(x, y, START_PX * scale, 0, 2 * Math.PI);
  }
  context.fill();
  context.globalAlpha = 1;
}

/** Draw cameras and points; isInside: but for the one in whose place the viewer stands. */
export function drawMarkers(context: CanvasRenderingContext2D, markers: Marker[], camera: PerspectiveCamera, isInside: boolean, colors: StageColors): void {
  const { width, height } = context.canvas;
  const pixels = (at: V3): [number, number] => [((at.x + 1) / 2) * width, ((1 - at.y) / 2) * height];
  const tanHalf = Math.tan((camera.fov / 360) * Math.PI);
  const shown = markers.map((marker) => ({ marker, distance: camera.position.distanceTo(new V3(...marker.place.position)) }));
  // The nearest last: it is in front.
  for (const { marker, distance } of shown.sort((a, b) => b.distance - a.distance)) {
    const at = new V3(...marker.place.position);
    const seen = at.clone().project(camera);
    if (seen.z > 1 || (isInside && distance < NEAREST_M)) continue;
    const radius = (MARKER_SIZE * height) / 2;
    const [x, y] = pixels(seen);
    const ahead = new V3(...(marker.place.rotation ? applied(marker.place.rotation, [1, 0, 0]) : NOWHERE));
    const tip = at.add(ahead.multiplyScalar(3.4 * MARKER_SIZE * tanHalf * distance)).project(camera);
    const [tipX, tipY] = pixels(tip);
    disc(context, x, y, radius * (marker.isChosen ? 1.45 : 1.2), colors.rim);
    context.fillStyle = marker.isUnsure ? colors.unsure : colors.accent;
    const along = Math.hypot(tipX - x, tipY - y);
    if (tip.z < 1 && along > radius) {
      // The base of the arrow lies half way to its tip.
      const [dx, dy] = [(tipX - x) / along, (tipY - y) / along];
      const [baseX, baseY] = [(x + tipX) / 2, (y + tipY) / 2];
      context.beginPath();
      context.moveTo(tipX, tipY);
      context.lineTo(baseX - 0.8 * radius * dy, baseY + 0.8 * radius * dx);
      context.lineTo(baseX + 0.8 * radius * dy, baseY - 0.8 * radius * dx);
      context.fill();
    }
    disc(context, x, y, radius * (marker.isChosen ? 1.1 : 0.85), context.fillStyle);
  }
}

function disc(context: CanvasRenderingContext2D, x: number, y: number, radius: number, color: string): void {
  context.fillStyle = color;
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fill();
}
