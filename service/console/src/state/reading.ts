/** How a scan was read, in words, and what its map asks. */

import type { Diagnostic, Place } from "../api/types.ts";

export const UNITS = { m: "metres", cm: "centimetres", mm: "millimetres", ft: "feet", "us-ft": "US survey feet" } as const;
export const UP_AXES = ["z", "y", "x", "-z", "-y", "-x"] as const;
const SOURCES = { given: "as given", file: "as the file says", judged: "by what was scanned", assumed: "assumed" } as const;

export type Question = NonNullable<Diagnostic["question"]>;
export type Choice = Question["choices"][number];

/** Return the doubts that an answer ends. */
export function questionsOf(place: Place): { message: string; question: Question }[] {
  return place.diagnostics.flatMap(({ message, question }) => (question ? [{ message, question }] : []));
}

/** Return unit, axes, coordinate system and floors in one line; empty for maps of earlier versions. */
export function readingWords(place: Place): string {
  const read = place.stats?.read_as;
  if (!read) return "";
  const unit = read.unit ? UNITS[read.unit] : "its own unit";
  const heights = read.height_unit && read.height_unit !== read.unit ? `, heights in ${UNITS[read.height_unit]} (${SOURCES[read.height_unit_from]})` : "";
  const floors = (place.stats?.floors ?? []).map((floor) => (floor.height_m === null ? "a floor" : `a storey ${floor.height_m.toFixed(2)} m high`));
  return [
    `Read in ${unit} (${SOURCES[read.unit_from]})${heights}`,
    `${read.up_axis} up (${SOURCES[read.up_axis_from]})`,
    place.coordinate_system?.slice(0, 40) ?? "no coordinate system",
    ...(floors.length ? [floors.join(", ")] : []),
  ].join("; ");
}
