/** The parts of the HTTP contract that the console shows; docs/api.md says what they mean. */

export type Vector3 = [number, number, number];

export interface Problem {
  type: string;
  title: string;
  status: number;
  detail: string;
  request_id?: string;
}

export type MapStatus = "queued" | "reading" | "indexing" | "ready" | "failed";

export interface MapStats {
  num_points: number;
  num_points_used: number;
  bounds: { min: Vector3; max: Vector3 };
  num_starts: number;
  index_bytes: number;
  seconds: Record<string, number>;
}

export interface Diagnostic {
  code: string;
  severity: "info" | "warning" | "error";
  message: string;
}

export interface Georeference {
  latitude_deg: number;
  longitude_deg: number;
  height_m: number;
  heading_deg: number;
}

export interface Place {
  id: string;
  name: string;
  tags: string[];
  revision: number;
  serving_revision: number | null;
  status: MapStatus;
  stage: string | null;
  progress: number;
  error: Problem | null;
  created_at: string;
  updated_at: string;
  stats: MapStats | null;
  diagnostics: Diagnostic[];
  georeference: Georeference | null;
  coordinate_system: string | null;
  geoid_undulation_m: number | null;
}

export interface Pose {
  frame: string;
  map_from_camera: {
    position_m: { x: number; y: number; z: number };
    quaternion: { x: number; y: number; z: number; w: number };
    matrix: number[][];
  };
  yaw_deg: number;
  pitch_deg: number;
  roll_deg: number;
  heading_deg: number;
  elevation_deg: number;
  camera_roll_deg: number;
  north: "map" | "true";
}

export interface CameraOfImage {
  model: "equirectangular" | "pinhole" | "opencv" | "opencv_fisheye" | "cylindrical";
  hfov_deg: number;
}

export interface Alternative {
  pose: Pose;
  confidence: number;
  map_id: string;
}

export interface Answer {
  id: string;
  status: "localized" | "ambiguous" | "not_localized";
  map_id: string | null;
  map_revision: number | null;
  pose: Pose | null;
  images: { pose: Pose | null; agreement: number | null; camera: CameraOfImage }[];
  confidence: number;
  accuracy: { position_m: number | null; orientation_deg: number | null; level: number } | null;
  alternatives: Alternative[];
  change: { panorama_changed_fraction: number | null; map_changed_fraction: number | null };
  artifacts: Partial<Record<"score_map_2d" | "score_map_3d" | "overlay", string>>;
  timings_s: Record<string, number>;
  search: Record<string, unknown>;
  warnings: string[];
}

export interface PendingAnswer {
  id: string;
  status: "queued" | "running" | "failed";
  error: Problem | null;
}

/** A batch as `GET /batches` lists it. */
export interface BatchOverview {
  id: string;
  status: "queued" | "running" | "done";
  created_at: string;
  map_ids: string[];
  tag: string | null;
  num_images: number;
  progress: number;
}

export interface Batch extends BatchOverview {
  counts: Record<"waiting" | "localized" | "ambiguous" | "not_localized" | "failed", number>;
  ignored: string[];
  items: BatchItem[];
  next_cursor: string | null;
}

export interface BatchItem {
  number: number;
  name: string;
  status: "waiting" | "localized" | "ambiguous" | "not_localized" | "failed";
  answer: Answer | null;
  error: Problem | null;
}

export interface ChangedCell {
  center_m: Vector3;
  num_changed: number;
  num_seen: number;
  last_changed_at: string;
}

export interface AnswerWithChange {
  id: string;
  created_at: string;
  position_m: Vector3;
  confidence: number;
  panorama_changed_fraction: number | null;
  map_changed_fraction: number | null;
}

export interface MapChanges {
  map_id: string;
  revision: number;
  lifetime_s: number;
  cell_m: number | null;
  answers: AnswerWithChange[];
  cells: ChangedCell[];
}

export interface RecentError {
  at: string;
  method: string;
  path: string;
  title: string | null;
  status: number | null;
  detail: string | null;
  request_id: string | null;
}

export interface Health {
  status: "ready" | "not_ready";
  waiting_for?: string[];
  version?: string;
  uptime_s?: number;
  redis?: "up" | "down";
  storage?: "writable" | "not_writable";
  workers?: { ready: boolean; waiting_for: string | null; num_workers: number; queue_depth: number; resident_bytes: number };
  maps?: Record<string, number>;
  recent_errors?: RecentError[];
}
