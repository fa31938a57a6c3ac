// Photo Sphere Viewer with a node of our `tour.json`, and the scan in the viewer's own scene.
import { Viewer } from "@photo-sphere-viewer/core";
import * as THREE from "three";
import { scanPoints } from "./scan_points.mjs";

// Its yaw 0 looks along +z, yaw 90 along −x, up is y; nodes are turned so that yaw 0 is the map's y axis.
const AXES = new THREE.Matrix4().set(-1, 0, 0, 0, 0, 0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 1);

export async function show(container, { number, headingDeg, shows }) {
  const tour = await (await fetch("psv/tour.json")).json();
  const node = tour.virtualTour.nodes[number];
  const viewer = new Viewer({
    container,
    ...tour.viewer,
    panorama: node.panorama,
    sphereCorrection: node.sphereCorrection,
    defaultYaw: `${headingDeg}deg`,
    defaultZoomLvl: 0,
    navbar: false,
    loadingTxt: "",
  });
  await new Promise((resolve) => viewer.addEventListener("ready", resolve, { once: true }));
  if (shows !== "photo") {
    const origin = new THREE.Vector3(...node.data.positionM);
    viewer.renderer.addObject(await scanPoints(origin, AXES, shows, 4));
  }
  if (shows === "scan") viewer.renderer.mesh.visible = false;
  viewer.needsUpdate();
  await new Promise((resolve) => setTimeout(resolve, 1500));
}
