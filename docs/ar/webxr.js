// Collects frames of a WebXR session, localizes them with panoloc and places content: docs/ar.md

const shots = [];
let last = 0;

// Call in every animation frame. space = await session.requestReferenceSpace("local-floor"),
// binding = new XRWebGLBinding(session, gl).
function offer(time, frame, space, binding, gl) {
  const view = frame.getViewerPose(space)?.views.find((each) => each.camera);
  if (!view || shots.length >= 6 || time - last < 1000) return;
  const q = view.transform.orientation;
  // New only when turned by 30 degrees from every other: cos(30° / 2) = 0.966.
  if (shots.some(({ turn }) => Math.abs(turn.x * q.x + turn.y * q.y + turn.z * q.z + turn.w * q.w) > 0.966)) return;
  const pixels = imageOf(binding.getCameraImage(view.camera), view.camera.width, view.camera.height, gl);
  shots.push({ jpeg: jpegOf(pixels), camera: entry(view), turn: q });
  last = time;
}

function entry(view) {
  const { width, height } = view.camera;
  const p = view.projectionMatrix;                   // column by column
  const t = view.transform.position;
  const q = view.transform.orientation;
  return {
    model: "pinhole",
    width_px: width, height_px: height,
    fx_px: p[0] * width / 2, fy_px: p[5] * height / 2,
    cx_px: (1 - p[8]) * width / 2, cy_px: (1 + p[9]) * height / 2,
    session_from_camera: {
      position_m: { x: t.x, y: t.y, z: t.z },
      quaternion: { x: q.x, y: q.y, z: q.z, w: q.w },
    },
  };
}

// The motion from the map (y up) to the session, or null when not localized.
async function sessionFromMap(service, mapId) {
  const form = new FormData();
  for (const shot of shots) form.append("image", await shot.jpeg, "frame.jpg");
  form.append("map_id", mapId);
  const options = { frame: "webxr", cameras: shots.map((shot) => shot.camera), session: { up: "known" } };
  form.append("options", JSON.stringify(options));
  const reply = await fetch(`${service}/localize`, { method: "POST", body: form });
  const answer = await reply.json();
  if (!reply.ok) throw new Error(answer.detail);
  for (const warning of answer.warnings) console.warn(warning);
  if (answer.status !== "localized") return null;
  const { position_m, quaternion } = answer.map_from_session;
  const mapFromSession = new XRRigidTransform(position_m, quaternion);
  return mapFromSession.inverse;
}

// With three.js: everything in this group has the map's coordinates. (x, y, z) of the scan is (x, z, -y) there.
function groupOfMap(sessionFromMap) {
  const group = new THREE.Group();
  group.matrixAutoUpdate = false;
  group.matrix.fromArray(sessionFromMap.matrix);
  return group;
}

function place(group, content, x, y, z) {
  content.position.set(x, z, -y);
  group.add(content);
}

function imageOf(texture, width, height, gl) {
  const rows = new Uint8ClampedArray(width * height * 4);
  const before = gl.getParameter(gl.FRAMEBUFFER_BINDING);
  const buffer = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, buffer);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(rows.buffer));
  gl.bindFramebuffer(gl.FRAMEBUFFER, before);
  gl.deleteFramebuffer(buffer);
  const image = new ImageData(width, height);
  for (let row = 0; row < height; row++)
    image.data.set(rows.subarray((height - 1 - row) * width * 4, (height - row) * width * 4), row * width * 4);
  return image;
}

function jpegOf(image) {
  const canvas = new OffscreenCanvas(image.width, image.height);
  canvas.getContext("2d").putImageData(image, 0, 0);
  return canvas.convertToBlob({ type: "image/jpeg", quality: 0.9 });
}
