/** What the console calls the models of the API; docs/api.md says what they mean. */

import type { Georeference as GivenGeoreference, Health as WholeHealth, Map, ProblemDocument } from "./schema.ts";

export type { Alternative, Batch, BatchItem, ChangedCell, Diagnostic, MapChanges, MapLink, MapStats } from "./schema.ts";
export type { ImageCamera as CameraOfImage, Localization as Answer, PendingLocalization as PendingAnswer, PoseAnswer as Pose } from "./schema.ts";

export type Vector3 = [number, number, number];

/** What the service said went wrong, or what the console found by itself, under no request id. */
export type Problem = Omit<ProblemDocument, "request_id"> & Partial<ProblemDocument>;

export type Georeference = Required<GivenGeoreference>;

/** A map of the service: `Map` is a class of JavaScript. */
export type Place = Omit<Map, "georeference"> & { georeference: Georeference | null };

/** A batch as `GET /batches` lists it. */
export type { BatchOverview } from "./schema.ts";

/** `GET /health`; of `GET /health/ready`, the status alone. */
export type Health = Pick<WholeHealth, "status"> & Partial<WholeHealth>;
