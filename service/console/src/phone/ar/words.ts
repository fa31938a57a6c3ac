/** What somebody reads who looks around with AR. */

import { PanolocError } from "../../../../../clients/js/src/index.ts";
import { linkWords } from "../words.ts";

export const LOOKING = "Looking for this place. Turn slowly on the spot.";
export const FOUND = "Found. Notes stay where you leave them.";
export const LOST = "The place is lost. Turn slowly on the spot until it is found again.";
export const UNTRACKED = "The phone does not know how it moves. Uncover the camera, and point it at furniture in good light.";

/** Return what a query failed of, and what to do. */
export function errorWords(error: unknown, hasKey: boolean): string {
  if (!(error instanceof PanolocError) || error.status === 0) return "There is no answer. The page goes on asking.";
  const { title, what } = linkWords(error, hasKey);
  return `${title}. ${what}`;
}
