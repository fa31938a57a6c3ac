// The points of a map as three.js draws them, in front of a photo, in upright bands that alternate with it.
import * as THREE from "three";

const BAND_PX = 200;

export async function scanPoints(origin, axes, shows, sizePx) {
  const positions = new Float32Array(await (await fetch("points.f32")).arrayBuffer());
  const colors = new Uint8Array(await (await fetch("colors.u8")).arrayBuffer());
  const placed = new Float32Array(positions.length);
  const at = new THREE.Vector3();
  for (let point = 0; point < positions.length; point += 3) {
    at.set(positions[point], positions[point + 1], positions[point + 2]).sub(origin);
    const distance = at.length();
    // Between the camera and the sphere of the photo, the nearest in front.
    at.multiplyScalar((1 + (8 * distance) / (distance + 3)) / distance).applyMatrix4(axes);
    placed.set([at.x, at.y, at.z], point);
  }
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(placed, 3));
  geometry.setAttribute("color", new THREE.BufferAttribute(colors, 3, true));
  const material = new THREE.PointsMaterial({ size: sizePx, sizeAttenuation: false, vertexColors: true, toneMapped: false });
  if (shows === "both") {
    material.onBeforeCompile = (shader) => {
      shader.fragmentShader = shader.fragmentShader.replace(
        "void main() {",
        `void main() { if (mod(gl_FragCoord.x, ${2 * BAND_PX}.0) < ${BAND_PX}.0) discard;`,
      );
    };
  }
  return new THREE.Points(geometry, material);
}
