/** Generated from the models of the HTTP API by `python -m panoloc.service.console.api_types`: change those instead. */

export interface Accuracy {
  position_m: number | null;
  orientation_deg: number | null;
  level: number;
}

export interface Alternative {
  pose: PoseAnswer;
  confidence: number;
  map_id: string;
}

export interface AnswerWithChange {
  id: string | null;
  created_at: string;
  position_m: [number, number, number];
  confidence: number;
  panorama_changed_fraction: number | null;
  map_changed_fraction: number | null;
}

export interface Batch {
  id: string;
  status: "queued" | "running" | "done";
  created_at: string;
  map_ids: string[];
  tag: string | null;
  num_images: number;
  progress: number;
  counts: BatchCounts;
  ignored: string[];
  items: BatchItem[];
  next_cursor: string | null;
}

export interface BatchCounts {
  waiting: number;
  localized: number;
  ambiguous: number;
  not_localized: number;
  failed: number;
}

export interface BatchItem {
  number: number;
  name: string;
  status: "waiting" | "localized" | "ambiguous" | "not_localized" | "failed";
  answer: Localization | null;
  error: ProblemDocument | null;
}

export interface BatchOverview {
  id: string;
  status: "queued" | "running" | "done";
  created_at: string;
  map_ids: string[];
  tag: string | null;
  num_images: number;
  progress: number;
}

export interface Box {
  min: [number, number, number];
  max: [number, number, number];
}

export interface Change {
  panorama_changed_fraction: number | null;
  map_changed_fraction: number | null;
}

export interface ChangedCell {
  center_m: [number, number, number];
  num_changed: number;
  num_seen: number;
  last_changed_at: string;
}

export interface Diagnostic {
  code: string;
  severity: "info" | "warning" | "error";
  message: string;
}

export interface FieldMistake {
  field: string;
  message: string;
}

export interface GeoPose {
  position: GeoPosition;
  quaternion: Quaternion;
}

export interface GeoPosition {
  lat: number;
  lon: number;
  h: number;
}

export interface Georeference {
  latitude_deg: number;
  longitude_deg: number;
  height_m?: number;
  heading_deg?: number;
}

export interface Health {
  status: "ready" | "not_ready";
  waiting_for: string[];
  version: string;
  uptime_s: number;
  redis: "up" | "down";
  storage: "writable" | "not_writable";
  workers: PoolHealth;
  recent_errors?: RecentError[];
  maps: Record<string, number>;
}

export interface ImageAnswer {
  pose: PoseAnswer | null;
  agreement: number | null;
  camera: ImageCamera;
}

export interface ImageCamera {
  model: "equirectangular" | "pinhole" | "opencv" | "opencv_fisheye" | "cylindrical";
  hfov_deg: number;
}

export interface Localization {
  id: string;
  status: "localized" | "ambiguous" | "not_localized";
  map_id: string | null;
  map_revision: number | null;
  pose: PoseAnswer | null;
  map_from_session: RigidMotion | null;
  images: ImageAnswer[];
  geopose: GeoPose | null;
  confidence: number;
  accuracy: Accuracy | null;
  alternatives: Alternative[];
  change: Change;
  timings_s: Record<string, number>;
  search: Record<string, unknown>;
  warnings: string[];
  reasons?: Array<"accuracy_too_low" | "check_camera" | "check_image" | "hfov_contradicted" | "images_contradict" | "map_left_out" | "map_not_ready" | "name_fewer_maps" | "not_kept" | "nothing_in_reach" | "places_look_alike" | "regions_ignored" | "turn_more" | "widen_hfov_range" | "widen_hints">;
  artifacts: Record<string, string>;
}

export interface Map {
  id: string;
  name: string;
  tags: string[];
  revision: number;
  serving_revision: number | null;
  status: "queued" | "reading" | "indexing" | "ready" | "failed";
  stage: string | null;
  progress: number;
  error: ProblemDocument | null;
  created_at: string;
  updated_at: string;
  stats: MapStats | null;
  diagnostics: Diagnostic[];
  georeference: Record<string, unknown> | null;
  coordinate_system: string | null;
  geoid_undulation_m?: number | null;
  owner?: string | null;
  shared_with?: string[];
  version?: number;
}

export interface MapChanges {
  map_id: string;
  revision: number;
  lifetime_s: number;
  cell_m: number | null;
  answers: AnswerWithChange[];
  cells: ChangedCell[];
}

export interface MapLink {
  url: string;
  key_id: string | null;
  qr_svg: string;
}

export interface MapStats {
  num_points: number;
  num_points_used: number;
  bounds: Box;
  origin_offset: [number, number, number];
  num_starts: number;
  index_bytes: number;
  seconds: Record<string, number>;
  coordinate_system?: string | null;
}

export interface PendingLocalization {
  id: string;
  status: "queued" | "running" | "failed";
  created_at: string;
  error: ProblemDocument | null;
}

export interface PoolHealth {
  ready: boolean;
  waiting_for: string | null;
  num_workers: number;
  queue_depth: number;
  resident_bytes: number;
}

export interface PoseAnswer {
  frame: "ros" | "opencv" | "webxr" | "unity";
  map_from_camera: RigidMotion;
  yaw_deg: number;
  pitch_deg: number;
  roll_deg: number;
  heading_deg: number;
  elevation_deg: number;
  camera_roll_deg: number;
  north: "map" | "true";
}

export interface Position {
  x: number;
  y: number;
  z: number;
}

export interface ProblemDocument {
  type: string;
  title: string;
  status: number;
  detail: string;
  request_id: string;
  fields?: FieldMistake[] | null;
}

export interface Quaternion {
  x: number;
  y: number;
  z: number;
  w: number;
}

export interface RecentError {
  at: string;
  method: string;
  path: string;
  type: string | null;
  title: string | null;
  status: number | null;
  detail: string | null;
  request_id: string | null;
}

export interface RigidMotion {
  position_m: Position;
  quaternion: Quaternion;
  matrix: Array<number[]>;
}
