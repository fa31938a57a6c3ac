/** Chooses what draws: WebGL where a graphics processor computes it, else the processor, which is faster than the WebGL that it would compute. */

import { drawsWithWebgl, wish } from "./graphics.ts";
import type { Painter, StageColors } from "./painter.ts";
import { ProcessorPainter } from "./processor_painter.ts";
import { WebglPainter } from "./webgl_painter.ts";

export function makePainter(canvas: HTMLCanvasElement, colors: StageColors): Painter {
  if (drawsWithWebgl()) {
    const context = canvas.getContext("webgl2", { antialias: false, alpha: false, powerPreference: "high-performance", preserveDrawingBuffer: true });
    if (context) return new WebglPainter(canvas, context, colors);
    if (wish === "webgl") throw new Error("expected a browser with WebGL 2, as ?draw=webgl asks for; leave that away");
  }
  return new ProcessorPainter(canvas, canvas.getContext("2d", { alpha: false })!, colors);
}
