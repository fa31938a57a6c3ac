/** What the tracker needs of a WebXR session with raw camera access. The types are the parts of WebXR's own that are read here. */

import type { Motion, Quaternion, Vector } from "./poses.ts";
import { Tracker, type Frame, type TrackerSettings } from "./tracker.ts";

export interface RigidTransform {
  readonly position: Vector;
  readonly orientation: Quaternion;
}

export interface View {
  readonly projectionMatrix: ArrayLike<number>;
  readonly transform: RigidTransform;
  readonly camera?: { readonly width: number; readonly height: number } | null | undefined;
}

export interface Session extends EventTarget {
  requestAnimationFrame(callback: (time: number, frame: SessionFrame) => void): number;
}

export interface SessionFrame {
  getViewerPose(space: never): { readonly views: readonly View[]; readonly transform: RigidTransform; readonly emulatedPosition: boolean } | null | undefined;
}

/** Return a transform of WebXR as a motion. */
export function motionOf({ position: { x, y, z }, orientation: q }: RigidTransform): Motion {
  return { position_m: { x, y, z }, quaternion: { x: q.x, y: q.y, z: q.z, w: q.w } };
}

/** Return the entry of `cameras` for the image of a view, which is aligned with the view: its pose, and intrinsics by its projection. */
export function entryOf({ projectionMatrix: p, transform, camera }: View): Frame["camera"] {
  if (!camera) throw new Error("expected a view with a camera; request the feature camera-access");
  const { width, height } = camera;
  const element = (index: number): number => p[index] ?? NaN; // column by column
  return {
    model: "pinhole",
    width_px: width,
    height_px: height,
    fx_px: (element(0) * width) / 2,
    fy_px: (element(5) * height) / 2,
    cx_px: ((1 - element(8)) * width) / 2,
    cy_px: ((1 + element(9)) * height) / 2,
    session_from_camera: motionOf(transform),
  };
}

/** Return what the camera of a view sees as a JPEG. To be called while its frame is shown. */
export function imageOf(session: Session, gl: WebGLRenderingContext | WebGL2RenderingContext, { camera }: View): Promise<Blob> {
  const { width, height } = camera as NonNullable<View["camera"]>;
  const { XRWebGLBinding } = globalThis as unknown as { XRWebGLBinding: new (...given: unknown[]) => { getCameraImage(camera: unknown): WebGLTexture } };
  const texture = new XRWebGLBinding(session, gl).getCameraImage(camera);
  const rows = new Uint8ClampedArray(width * height * 4);
  const before = gl.getParameter(gl.FRAMEBUFFER_BINDING) as WebGLFramebuffer | null;
  const buffer = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, buffer);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(rows.buffer));
  gl.bindFramebuffer(gl.FRAMEBUFFER, before);
  gl.deleteFramebuffer(buffer);
  const image = new ImageData(width, height);
  // Rows of textures begin at the bottom.
  for (let row = 0; row < height; row += 1) image.data.set(rows.subarray((height - 1 - row) * width * 4, (height - row) * width * 4), row * width * 4);
  const canvas = new OffscreenCanvas(width, height);
  canvas.getContext("2d")?.putImageData(image, 0, 0);
  return canvas.convertToBlob({ type: "image/jpeg", quality: 0.9 });
}

/**
 * Return a tracker that follows a WebXR session until that ends or `stop()` is called.
 *
 * session: with the features `local-floor` (or `local`) and `camera-access`. space: a reference space of it, with y up.
 */
export function trackSession<Space extends EventTarget>(
  session: Session,
  space: Space,
  gl: WebGLRenderingContext | WebGL2RenderingContext,
  settings: Omit<TrackerSettings, "capture">,
): Tracker {
  let view: View | undefined;
  const capture = (): Frame | null => (view?.camera ? { image: imageOf(session, gl, view), camera: entryOf(view) } : null);
  const tracker = new Tracker({ ...settings, capture });
  const follow = (_: number, frame: SessionFrame): void => {
    if (tracker.isStopped) return;
    session.requestAnimationFrame(follow);
    const pose = frame.getViewerPose(space as never);
    view = pose?.views.find(({ camera }) => camera);
    tracker.update(pose && !pose.emulatedPosition ? motionOf((view ?? pose).transform) : null);
  };
  space.addEventListener("reset", () => tracker.reset());
  session.addEventListener("end", () => tracker.stop());
  session.requestAnimationFrame(follow);
  return tracker;
}
