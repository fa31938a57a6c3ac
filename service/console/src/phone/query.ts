/** What is asked of pictures, and where an answer lies on the plan. */

import type { Answer, Pose, Vector3 } from "../api/types.ts";
import { type Upload, upload } from "../api/upload.ts";
import type { Shot } from "./camera.ts";
import { acrossWidth, type Range } from "./lens.ts";
import { lookOf, type Quaternion } from "./orientation.ts";

export interface TurnedShot extends Shot {
  /** session_from_camera; null where the phone does not tell. */
  orientation: Quaternion | null;
}

/** Metres, counter-clockwise degrees from +x. */
export interface Standing {
  x: number;
  y: number;
  z: number;
  yawDeg: number;
}

/** Of the lens from the axis that somebody turns about with a phone in the hands, and how far off that is. */
const ARM_M = 0.35;
const ARM_NOISE_M = 0.1;
const TURN_NOISE_DEG = 2;

type Options = Record<string, unknown>;

/**
 * Ask where pictures were taken, of several while somebody turned on the spot. range: of their field of view, across the longer side; null:
 * as their files say.
 */
export function ask(mapId: string, shots: TurnedShot[], range: Range | null): Upload<Answer> {
  const form = new FormData();
  const isTurned = shots.every((shot) => shot.orientation);
  const session = isTurned ? { up: "known", position_noise_m: ARM_NOISE_M, orientation_noise_deg: TURN_NOISE_DEG } : undefined;
  const cameras = range || isTurned ? shots.map((shot) => ({ ...(range && lensOf(shot, range)), ...turnOf(shot) })) : undefined;
  form.append("options", JSON.stringify({ frame: "webxr", session, cameras }));
  form.append("map_id", mapId);
  for (const [number, shot] of shots.entries()) form.append("image", shot.image, `${number + 1}.jpg`);
  return upload<Answer>({ path: "/localize", form });
}

export function standingAt(pose: Pose): Standing {
  const { x, y, z } = pose.map_from_camera.position_m;
  return { x, y: -z, z: y, yawDeg: pose.yaw_deg };
}

function lensOf(shot: TurnedShot, range: Range): Options {
  return { model: "pinhole", hfov_range_deg: range.map((deg) => acrossWidth(deg, shot.width, shot.height)) };
}

function turnOf({ orientation }: TurnedShot): Options {
  if (orientation === null) return {};
  const look = lookOf(orientation);
  const [x, y, z]: Vector3 = [ARM_M * look[0], 0, ARM_M * look[2]];
  const [qx, qy, qz, qw] = orientation;
  return { session_from_camera: { position_m: { x, y, z }, quaternion: { x: qx, y: qy, z: qz, w: qw } } };
}
