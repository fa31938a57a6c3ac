/** Figures of answers and maps in words. */

import type { Answer, Place } from "../api/types.ts";

export function statusWords(status: Answer["status"]): string {
  return { localized: "Found", ambiguous: "Several places fit", not_localized: "Not found" }[status];
}

/** What programs read, in brackets: fields, options of the command line, paths. */
const FOR_PROGRAMS = / \((?:(?:--[a-z]|frame|curl|options\.|[a-z]+(?:_[a-z]+)+(?![\w.])|see \/|[A-Z]+ \/)[^(),]*(?:, )?)+\)/g;

/** What the service says, as a sentence: without the name of the field at fault before it, and without what else programs read. */
export function sentence(said: string): string {
  return said.replace(/^[a-z_.\d]+: /, "").replace(FOR_PROGRAMS, "").replace(/^./, (first) => first.toUpperCase()).replace(/([^.!?…])$/, "$1.");
}

/** How an answer stands; no confidence is told of what a person has confirmed. */
export function verdictWords({ status, confidence, placed_by }: Pick<Answer, "status" | "confidence" | "placed_by">): string {
  if (placed_by === "hand") return "Placed by hand";
  return status === "localized" ? confidenceWords(confidence) : statusWords(status);
}

/** What a row of a list says of an answer. */
export function answerWords(answer: Answer): string {
  const found = statusWords(answer.status);
  if (answer.placed_by === "hand") return `${found} · by hand`;
  return answer.status === "localized" ? `${found} · ${confidenceWords(answer.confidence).toLowerCase()}` : found;
}

export function confidenceWords(confidence: number): string {
  if (confidence >= 0.95) return "Almost certain";
  if (confidence >= 0.8) return "Very likely";
  if (confidence >= 0.5) return "Likely";
  if (confidence >= 0.2) return "Doubtful";
  return "Very doubtful";
}

/** Nothing is certain: no figure says 100. */
export function percentWords(confidence: number): string {
  return confidence > 0.99 ? "> 99\u00a0%" : `${Math.round(100 * confidence)}\u00a0%`;
}

/** Return how sure a place is; one that was clicked by hand has no confidence that counts. */
export function sureWords({ confidence, placed_by }: Pick<Answer, "confidence" | "placed_by">): string {
  return placed_by === "hand" ? "by hand" : percentWords(confidence);
}

export function isSureEnough({ confidence, placed_by }: Pick<Answer, "confidence" | "placed_by">, least: number): boolean {
  return placed_by === "hand" || confidence >= least;
}

export function radiusWords(answer: Answer): string {
  const radius = answer.accuracy?.position_m;
  if (radius == null) return "Precision unknown.";
  const angle = answer.accuracy?.orientation_deg;
  return `Error below ${lengthWords(radius)}${angle == null ? "" : ` and ${angle < 1 ? Math.max(0.1, angle).toFixed(1) : Math.round(angle)}°`} with 68 % probability.`;
}

export function lengthWords(metres: number): string {
  if (metres < 0.01) return `${Math.max(1, Math.round(metres * 1000))} mm`;
  if (metres < 1) return `${Math.max(1, Math.round(metres * 100))} cm`;
  return `${metres < 10 ? metres.toFixed(1) : Math.round(metres)} m`;
}

export function changeWords(share: number | null): string {
  if (share == null) return "unknown";
  if (share < 0.05) return "next to nothing";
  if (share < 0.2) return "a little";
  if (share < 0.45) return "much";
  return "most";
}

export function stageWords(place: Place): string {
  if (place.status === "ready") return "Ready";
  if (place.status === "failed") return "Failed";
  return (place.stage ?? place.status).replace(/^./, (first) => first.toUpperCase());
}

export function countWords(count: number): string {
  if (count >= 1e6) return `${(count / 1e6).toFixed(count < 1e7 ? 1 : 0)} M`;
  if (count >= 1e4) return `${Math.round(count / 1e3)} k`;
  return String(count);
}

export function bytesWords(bytes: number): string {
  const units = ["B", "kB", "MB", "GB", "TB"];
  const power = Math.min(units.length - 1, Math.floor(Math.log10(Math.max(1, bytes)) / 3));
  const value = bytes / 1000 ** power;
  return `${value < 10 && power > 0 ? value.toFixed(1) : Math.round(value)} ${units[power]}`;
}

export function secondsWords(seconds: number): string {
  if (seconds < 0.001) return "< 1 ms";
  if (seconds < 1) return `${Math.round(seconds * 1000)} ms`;
  if (seconds < 100) return `${seconds.toFixed(seconds < 10 ? 2 : 1)} s`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min`;
  return `${(seconds / 3600).toFixed(1)} h`;
}

export function dateWords(time: string): string {
  return new Date(time).toLocaleString(undefined, { dateStyle: "medium", timeStyle: "short" });
}

export function sizeWords(place: Place): string {
  const bounds = place.stats?.bounds;
  if (!bounds) return "";
  return bounds.max.map((value, axis) => (value - bounds.min[axis]!).toFixed(1)).join(" × ") + " m";
}
