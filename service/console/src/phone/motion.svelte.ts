/** How the phone is turned now. iOS asks its user first, and only where a tap asked for it. */

import type { Vector3 } from "../api/types.ts";
import { angleBetween, cameraOrientation, lookOf, type Quaternion } from "./orientation.ts";

const LOOK_MS = 100;
/** Of the time before a picture, in which the phone turned no further than that: it is sharp, and sensors lag behind it no more. */
const STEADY_LOOKS = 4;
const STEADY_DEG = 2.5;

let now = $state.raw<Quaternion | null>(null);
let recent = $state.raw<Vector3[]>([]);
let timer: ReturnType<typeof setInterval> | undefined;

export const motion = {
  /** session_from_camera, null where the phone does not tell. */
  get now(): Quaternion | null {
    return now;
  },
  get isSteady(): boolean {
    const last = recent.at(-1);
    return last !== undefined && recent.length === STEADY_LOOKS && recent.every((each) => angleBetween(each, last) < STEADY_DEG);
  },
  /** Begin to listen; call it in the handler of a tap. */
  async start(): Promise<void> {
    if (timer !== undefined || typeof DeviceOrientationEvent === "undefined") return;
    const asking = DeviceOrientationEvent as unknown as { requestPermission?: () => Promise<string> };
    const allowed = await asking.requestPermission?.().catch(() => "denied");
    if (allowed === "denied") return;
    window.addEventListener("deviceorientation", take);
    timer = setInterval(() => {
      if (now) recent = [...recent, lookOf(now)].slice(-STEADY_LOOKS);
    }, LOOK_MS);
  },
};

function take({ alpha, beta, gamma }: DeviceOrientationEvent): void {
  if (alpha === null || beta === null || gamma === null) return;
  now = cameraOrientation(alpha, beta, gamma, screen.orientation?.angle ?? window.orientation ?? 0);
}
