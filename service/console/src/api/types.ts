/** What the console calls the models of the API; docs/api.md says what they mean. Their types are those of the npm package. */

import type { components } from "../../../../clients/js/src/schema.ts";

type Schemas = components["schemas"];

export type Alternative = Schemas["Alternative"];
export type Answer = Schemas["Localization"];
export type PendingAnswer = Schemas["PendingLocalization"];
export type Pose = Schemas["PoseAnswer"];
export type CameraOfImage = Schemas["ImageCamera"];
export type Batch = Schemas["Batch"];
export type BatchItem = Schemas["BatchItem"];
/** A batch as `GET /batches` lists it. */
export type BatchOverview = Schemas["BatchOverview"];
export type ChangedCell = Schemas["ChangedCell"];
export type MapChanges = Schemas["MapChanges"];
export type MapLink = Schemas["MapLink"];
export type MapStats = Schemas["MapStats"];
export type Coordinates = Schemas["Coordinates"];
export type HandPlacement = Schemas["HandPlacement"];
export type PlacedPose = Schemas["PlacedPose"];
export type ControlReport = Schemas["ControlReport"];
export type ControlPoint = Schemas["CheckedPoint"];
export type Diagnostic = Schemas["Diagnostic"];

export type Vector3 = [number, number, number];

/** What the service said went wrong, or what the console found by itself, under no request id. */
export type Problem = Omit<Schemas["ProblemDocument"], "request_id"> & Partial<Schemas["ProblemDocument"]>;

export type Georeference = Required<Schemas["Georeference"]>;

/** A map of the service: `Map` is a class of JavaScript. */
export type Place = Omit<Schemas["Map"], "georeference"> & { georeference: Georeference | null };

/** `GET /health`; of `GET /health/ready`, the status alone. */
export type Health = Pick<Schemas["Health"], "status"> & Partial<Schemas["Health"]>;
