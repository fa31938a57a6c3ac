/** Whether a graphics processor computes WebGL here. */

/** Of renderers that are no graphics processor, as browsers on Linux, Windows and macOS name them. */
const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;

/** `?draw=webgl` and `?draw=processor` in the page's address, before the `#`, decide otherwise. */
export const wish = new URLSearchParams(location.search).get("draw");
let hasOne: boolean | null = null;

export function drawsWithWebgl(): boolean {
  return wish === "webgl" || (wish !== "processor" && (hasOne ??= hasGraphicsProcessor()));
}

/** Tell by the name of what computes WebGL; on a canvas of its own, because one that had WebGL once has nothing else any more. */
function hasGraphicsProcessor(): boolean {
  const context = document.createElement("canvas").getContext("webgl2");
  if (context === null) return false;
  const name = rendererOf(context);
  context.getExtension("WEBGL_lose_context")?.loseContext();
  return !SOFTWARE.test(name);
}

/** Return the name of what computes WebGL, as far as the browser tells. */
export function rendererOf(context: WebGL2RenderingContext): string {
  const named = context.getExtension("WEBGL_debug_renderer_info");
  return String(context.getParameter(named ? named.UNMASKED_RENDERER_WEBGL : context.RENDERER));
}
