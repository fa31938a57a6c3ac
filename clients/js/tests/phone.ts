/** A phone with WebXR under Node: iwer's device, driven frame by frame, and stand-ins for what it expects of a browser. */

import { XRDevice, XRView } from "iwer";
import type { Motion } from "../src/poses.ts";
import type { Session } from "../src/webxr.ts";

export interface Lens {
  width_px: number;
  height_px: number;
  fx_px: number;
}

const FEATURES = ["viewer", "local", "local-floor", "camera-access"];
const CONFIG = {
  name: "phone",
  supportedSessionModes: ["immersive-ar"],
  supportedFeatures: FEATURES,
  supportedFrameRates: [30],
  isSystemKeyboardSupported: false,
  internalNominalFrameRate: 30,
  environmentBlendModes: { "immersive-ar": "alpha-blend" },
  interactionMode: "screen-space",
  userAgent: "phone",
};

const element = (): object => ({ style: {}, dataset: {}, appendChild() {}, removeChild() {} });

export class Phone {
  /** What the camera sees at this moment, as a JPEG; null: no image in this frame. */
  picture: Blob | null = null;
  readonly gl: WebGL2RenderingContext;
  readonly #device: XRDevice;
  #onFrame: FrameRequestCallback = () => undefined;

  constructor({ width_px, height_px, fx_px }: Lens) {
    const canvas = { ...element(), width: width_px, height: height_px };
    Object.assign(globalThis, {
      document: { createElement: element, body: element() },
      window: { innerWidth: width_px, innerHeight: height_px, dispatchEvent() {} },
      WebGL2RenderingContext: class {},
      DOMPointReadOnly: class {
        static fromPoint: (point: { x?: number; y?: number; z?: number; w?: number }) => object = ({ x = 0, y = 0, z = 0, w = 1 }) => ({ x, y, z, w });
        constructor(x = 0, y = 0, z = 0, w = 1) {
          Object.assign(this, { x, y, z, w });
        }
      },
      localStorage: { getItem: () => null, setItem() {} },
      requestAnimationFrame: (callback: FrameRequestCallback) => ((this.#onFrame = callback), 1),
      cancelAnimationFrame: () => (this.#onFrame = () => undefined),
    });
    // Whatever is asked of the context is a function that does nothing.
    this.gl = new Proxy({}, { get: (_, name) => (name === "canvas" ? canvas : () => []) }) as never;
    this.#device = new XRDevice(CONFIG as never, { ipd: 0, fovy: 2 * Math.atan(height_px / 2 / fx_px) } as never);
    this.#device.installRuntime();
    // Raw camera access, which iwer does not emulate: one camera, and its pixels, which become the picture.
    Object.defineProperty(XRView.prototype, "camera", {
      get: () => this.picture && { width: width_px, height: height_px },
      configurable: true,
    });
    const picture = (): Promise<Blob | null> => Promise.resolve(this.picture);
    Object.assign(globalThis, {
      XRWebGLBinding: class { getCameraImage(): void {} },
      ImageData: class { data = { set(): void {} }; },
      OffscreenCanvas: class { getContext(): void {} convertToBlob = picture; },
    });
  }

  async start(): Promise<{ session: Session; space: EventTarget }> {
    const session = await navigator.xr!.requestSession("immersive-ar", { requiredFeatures: ["local-floor", "camera-access"] });
    const space = await session.requestReferenceSpace("local-floor");
    await session.updateRenderState({ baseLayer: new XRWebGLLayer(session, this.gl) });
    this.end = () => session.end();
    return { session, space };
  }

  end: () => Promise<void> = () => Promise.resolve();

  /** Show one frame, from this pose. jumps: the session tells that its origin did. */
  show(sessionFromCamera: Motion, jumps = false): void {
    if (jumps) this.#device.recenter();
    const { position_m: p, quaternion: q } = sessionFromCamera;
    this.#device.position.set(p.x, p.y, p.z);
    this.#device.quaternion.set(q.x, q.y, q.z, q.w);
    this.#onFrame(0);
  }
}
