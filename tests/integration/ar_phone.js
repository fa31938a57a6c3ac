// A phone with AR in a browser: iwer's device, and stand-ins for what that lacks, which are raw camera access and the DOM overlay.
{
  // A dozen frames in a second: here a processor draws them, and the session never stops asking for the next.
  const { requestAnimationFrame: next } = globalThis;
  globalThis.requestAnimationFrame = (draw) => setTimeout(() => next(draw), 66);
  globalThis.cancelAnimationFrame = clearTimeout;

  const device = new IWER.XRDevice(
    {
      name: "phone",
      supportedSessionModes: ["immersive-ar"],
      supportedFeatures: ["viewer", "local", "camera-access", "dom-overlay"],
      supportedFrameRates: [30],
      isSystemKeyboardSupported: false,
      internalNominalFrameRate: 30,
      environmentBlendModes: { "immersive-ar": "alpha-blend" },
      interactionMode: "screen-space",
      userAgent: navigator.userAgent,
    },
    { ipd: 0, fovy: FOVY_RAD },
  );
  device.installRuntime({ forceInstall: true });
  Object.defineProperty(XRSession.prototype, "domOverlayState", { value: { type: "screen" } });

  let picture = null;
  Object.defineProperty(XRView.prototype, "camera", { get: () => picture && { width: picture.naturalWidth, height: picture.naturalHeight } });
  globalThis.XRWebGLBinding = class {
    constructor(session, gl) {
      this.gl = gl;
    }
    getCameraImage() {
      const { gl } = this;
      gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
      gl.pixelStorei(gl.UNPACK_FLIP_Y_WEBGL, true); // rows of textures begin at the bottom
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, picture);
      return gl.getParameter(gl.TEXTURE_BINDING_2D);
    }
  };

  globalThis.endSession = () => device.activeSession.end();
  const frame = () => new Promise(requestAnimationFrame);
  // Move to a pose, by little in each frame, however long frames take; then the camera sees the picture.
  globalThis.holdPhone = async ({ position, quaternion }, url) => {
    const seen = new Image();
    seen.src = url;
    await seen.decode();
    picture = null;
    const [from, turn] = [[...device.position.vec3], [...device.quaternion.quat]];
    const cosine = turn.reduce((sum, value, index) => sum + value * quaternion[index], 0);
    const metres = Math.hypot(...from.map((value, index) => position[index] - value));
    const steps = Math.ceil(Math.max(metres / 0.05, (2 * Math.acos(Math.min(1, Math.abs(cosine)))) / 0.08, 1));
    for (let step = 1; step <= steps; step += 1) {
      const between = (start, end) => start + (step / steps) * (end - start);
      const raw = turn.map((value, index) => between(Math.sign(cosine) * value, quaternion[index]));
      device.position.set(...from.map((value, index) => between(value, position[index])));
      device.quaternion.set(...raw.map((value) => value / Math.hypot(...raw)));
      await frame();
    }
    picture = seen;
  };
}
