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
/** Around the place that several pictures found: one picture says it more exactly, since arms differ. */
const NEAR_M = 1;
const NEAR_DEG = 25;

type Options = Record<string, unknown>;

/** Ask where one picture was taken. range: of its field of view, across the longer side; null: as its file says. */
export function askOne(mapId: string, shot: TurnedShot, range: Range | null, near?: Standing): Upload<Answer> {
  const hints = near && { position_m: [near.x, near.y, near.z], radius_m: NEAR_M, heading_deg: near.yawDeg, heading_tolerance_deg: NEAR_DEG };
  const lens = range && { model: "pinhole", hfov_range_deg: range.map((deg) => acrossWidth(deg, shot.width, shot.height)) };
  const cameras = lens || shot.orientation ? [{ ...lens, ...turnOf(shot) }] : undefined;
  return send(mapId, [shot], { hints, cameras });
}

/** Ask where pictures were taken while somebody turned on the spot; hfovDeg: across the longer side. */
export function askTogether(mapId: string, shots: TurnedShot[], hfovDeg: number): Upload<Answer> {
  const cameras = shots.map((shot) => ({ model: "pinhole", hfov_deg: acrossWidth(hfovDeg, shot.width, shot.height), ...turnOf(shot) }));
  return send(mapId, shots, { cameras });
}

export function standingAt(pose: Pose): Standing {
  const { x, y, z } = pose.map_from_camera.position_m;
  return { x, y: -z, z: y, yawDeg: pose.yaw_deg };
}

function send(mapId: string, shots: TurnedShot[], options: Options): Upload<Answer> {
  const form = new FormData();
  const isTurned = shots.every((shot) => shot.orientation);
  const session = isTurned ? { up: "known", position_noise_m: ARM_NOISE_M, orientation_noise_deg: TURN_NOISE_DEG } : undefined;
  form.append("options", JSON.stringify({ frame: "webxr", session, ...options }));
  form.append("map_id", mapId);
  for (const [number, shot] of shots.entries()) form.append("image", shot.image, `${number + 1}.jpg`);
  return upload<Answer>({ path: "/localize", form });
}

function turnOf({ orientation }: TurnedShot): Options {
  if (orientation === null) return {};
  const look = lookOf(orientation);
  const [x, y, z]: Vector3 = [ARM_M * look[0], 0, ARM_M * look[2]];
  const [qx, qy, qz, qw] = orientation;
  return { session_from_camera: { position_m: { x, y, z }, quaternion: { x: qx, y: qy, z: qz, w: qw } } };
}
