// A sphere as Potree 1.8 turns it (`Images360`), with a line of our `coordinates.txt`, and the scan around it: z up, map coordinates.
// Potree itself is on no package registry in this version, so its formula stands here.
import * as THREE from "three";
import { scanPoints } from "./scan_points.mjs";

const FIELD_OF_VIEW_DEG = 90; // of the height, as of Photo Sphere Viewer at its widest

export async function show(container, { number, headingDeg, shows }) {
  const lines = (await (await fetch("potree/coordinates.txt")).text()).split(/\r?\n/).slice(1);
  const [name, , ...numbers] = lines[number].split("\t");
  const [long, lat, alt, course, pitch, roll] = numbers.map(Number);
  const texture = await new THREE.TextureLoader().loadAsync(name);
  texture.wrapS = THREE.RepeatWrapping;
  texture.repeat.x = -1;
  const material = new THREE.MeshBasicMaterial({ map: texture, side: THREE.BackSide });
  const sphere = new THREE.Mesh(new THREE.SphereGeometry(10, 128, 128), material);
  const [x, y, z] = [roll + 90, -pitch, -course + 90].map(THREE.MathUtils.degToRad);
  sphere.rotation.set(x, y, z, "ZYX");
  const scene = new THREE.Scene();
  if (shows !== "scan") scene.add(sphere);
  if (shows !== "photo") {
    scene.add(await scanPoints(new THREE.Vector3(long, lat, alt), new THREE.Matrix4(), shows, 4));
  }
  const { clientWidth, clientHeight } = container;
  const camera = new THREE.PerspectiveCamera(FIELD_OF_VIEW_DEG, clientWidth / clientHeight, 0.1, 100);
  camera.up.set(0, 0, 1);
  const heading = THREE.MathUtils.degToRad(headingDeg);
  camera.lookAt(Math.sin(heading), Math.cos(heading), 0);
  const renderer = new THREE.WebGLRenderer({ antialias: false, preserveDrawingBuffer: true });
  // Colours go through as they are, as in the three.js of Potree 1.8.
  renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
  renderer.setSize(clientWidth, clientHeight);
  container.appendChild(renderer.domElement);
  renderer.render(scene, camera);
}
