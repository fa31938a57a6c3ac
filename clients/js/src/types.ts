/** What the models of the API are called here; docs/api.md of the service says what their fields mean. */

import type { components } from "./schema.ts";

type Schemas = components["schemas"];

export type Localization = Schemas["Localization"];
export type Localized = Schemas["Localized"];
export type Reason = NonNullable<Localized["reasons"]>[number];
export type LocalizeOptions = Schemas["LocalizeOptions"];
export type CameraEntry = Schemas["Camera"];
export type ScanMap = Schemas["Map"];
export type MapOptions = Schemas["MapOptions"];
export type Batch = Schemas["Batch"];
export type BatchOptions = Schemas["BatchOptions"];
export type ProblemDocument = Schemas["ProblemDocument"];
