/** Client of a panoloc service, and what keeps AR content at its place in a map. */

export { Panoloc, type Place, type Query } from "./client.ts";
export { compose, inverse, matrixOf, transform, type Motion, type Quaternion, type Vector } from "./poses.ts";
export { PanolocError, type Sending } from "./requests.ts";
export type * from "./schema.ts";
export { anchor, scanPoint, type Anchored } from "./three.ts";
export { Tracker, type Frame, type TrackerEvents, type TrackerSettings } from "./tracker.ts";
export type * from "./types.ts";
export { entryOf, imageOf, motionOf, trackSession, type RigidTransform, type Session, type SessionFrame, type View } from "./webxr.ts";
