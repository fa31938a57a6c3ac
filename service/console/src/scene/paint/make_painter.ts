/** Chooses what draws: WebGL where a graphics processor computes it, else the processor, which is faster than the WebGL that it would compute. */

import type { Painter, StageColors } from "./painter.ts";
import { ProcessorPainter } from "./processor_painter.ts";
import { rendererOf, WebglPainter } from "./webgl_painter.ts";

/** Of renderers that are no graphics processor, as browsers on Linux, Windows and macOS name them. */
const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;

/** `?draw=webgl` and `?draw=processor` in the page's address, before the `#`, decide otherwise. */
const wish = new URLSearchParams(location.search).get("draw");
let hasOne: boolean | null = null;

export function drawsWithWebgl(): boolean {
  return wish === "webgl" || (wish !== "processor" && (hasOne ??= hasGraphicsProcessor()));
}

export function makePainter(canvas: HTMLCanvasElement, colors: StageColors): Painter {
  if (drawsWithWebgl()) {
    const context = canvas.getContext("webgl2", { antialias: false, alpha: false, powerPreference: "high-performance", preserveDrawingBuffer: true });
    if (context) return new WebglPainter(canvas, context, colors);
    if (wish === "webgl") throw new Error("expected a browser with WebGL 2, as ?draw=webgl asks for; leave that away");
  }
  return new ProcessorPainter(canvas, canvas.getContext("2d", { alpha: false })!, colors);
}

/** Tell by the name of what computes WebGL; on a canvas of its own, because one that had WebGL once has nothing else any more. */
function hasGraphicsProcessor(): boolean {
  const context = document.createElement("canvas").getContext("webgl2");
  if (context === null) return false;
  const name = rendererOf(context);
  context.getExtension("WEBGL_lose_context")?.loseContext();
  return !SOFTWARE.test(name);
}
