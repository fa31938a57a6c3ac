/**
 * Runs the example of the README in the first seconds of a walk: `node example.ts EXAMPLE FOLDER`. EXAMPLE: the module. FOLDER: of
 * tests/integration/walked_room.py. Prints as JSON whether content is shown, and how far from its place.
 */

import { openAsBlob, readFileSync } from "node:fs";
import { join } from "node:path";
import { setTimeout } from "node:timers/promises";
import { pathToFileURL } from "node:url";
import { Camera, Group, Object3D, Scene, Vector3, type WebGLRenderer } from "three";
import { scanPoint, type Motion, type Tracker } from "../src/index.ts";
import { Phone, type Lens } from "./phone.ts";

interface Walked {
  camera: Lens;
  poses_per_s: number;
  frames: number[];
  map_from_camera: Motion[];
}

const [example = "", folder = ""] = process.argv.slice(2);
type Place = (content: Object3D, renderer: WebGLRenderer, scene: Scene, camera: Camera) => Tracker;
const { place } = (await import(pathToFileURL(example).href)) as { place: Place };
const walked = JSON.parse(readFileSync(join(folder, "walk.json"), "utf8")) as Walked;
const phone = new Phone(walked.camera);
const { session, space } = await phone.start();
let draw = (): void => undefined;
const renderer = {
  xr: { getSession: () => session, getReferenceSpace: () => space },
  getContext: () => phone.gl,
  setAnimationLoop: (loop: () => void) => void (draw = loop),
  render: () => undefined,
};
const [content, scene] = [new Group(), new Scene()];
const tracker = place(content, renderer as never, scene, new Camera());
tracker.on("error", (error) => console.error(error));
const began_ms = performance.now();
let step = 0;
let isShown = false;
for (; !isShown && step < walked.map_from_camera.length; step = Math.floor(((performance.now() - began_ms) / 1000) * walked.poses_per_s)) {
  const frame = walked.frames.filter((each) => each <= step).at(-1)!;
  phone.picture = frame === step ? await openAsBlob(join(folder, `${frame}.jpg`), { type: "image/jpeg" }) : null;
  // The session began at the first pose: it has the axes of the map there.
  phone.show(walked.map_from_camera[step]!);
  draw();
  isShown = content.parent!.visible;
  await setTimeout(5);
}
tracker.stop();
await phone.end();
scene.updateMatrixWorld();
const { x, y, z } = scanPoint(1.2, 0.4, 1.5);
console.log(JSON.stringify({ isShown, error_m: content.getWorldPosition(new Vector3()).distanceTo(new Vector3(x, y, z)) }));
