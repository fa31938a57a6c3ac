/** Whether the browser can show notes in a room, and its session for that. What follows the session is loaded when one begins. */

/** Whether the page may ask for AR. Whether the device has it all is known when a session begins. */
export async function offersAr(): Promise<boolean> {
  const page = globalThis as unknown as Record<string, { prototype: object } | undefined>;
  const has = (name: string, member: string): boolean => member in (page[name]?.prototype ?? {});
  if (!navigator.xr || !has("XRWebGLBinding", "getCameraImage") || !has("XRSession", "domOverlayState")) return false;
  return navigator.xr.isSessionSupported("immersive-ar").catch(() => false);
}

/** Begin a session that shows an element over what the camera sees. Rejects with a DOMException, whose name says why. */
export function openAr(root: Element): Promise<XRSession> {
  return navigator.xr!.requestSession("immersive-ar", { requiredFeatures: ["local", "camera-access", "dom-overlay"], domOverlay: { root } });
}

/** Return why there is no AR, and what to do. */
export function arWords(error: unknown): string {
  const name = error instanceof DOMException ? error.name : "";
  if (name === "NotAllowedError") return "The browser may not use the camera for AR. Allow camera and AR in the settings of this page and try again, or take pictures.";
  if (name === "NotSupportedError") return "This device has no AR with camera access. Install or renew Google Play Services for AR, or take pictures.";
  if (name === "InvalidStateError") return "Another page uses AR. Close it and try again.";
  return "AR cannot be started. Try again, or take pictures.";
}
