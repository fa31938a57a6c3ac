/** What a visitor reads of an answer. */

import type { Answer, Problem } from "../api/types.ts";
import { lengthWords } from "../state/words.ts";
import { signed } from "./orientation.ts";

type Reason = NonNullable<Answer["reasons"]>[number];

const ADVICE: Partial<Record<Reason, string>> = {
  accuracy_too_low: "Take more pictures while you turn.",
  check_camera: "Take new pictures without zoom, and turn on the spot: do not walk between them.",
  check_image: "Take new pictures. Much may have changed here since the scan.",
  images_contradict: "Take new pictures, and turn on the spot: do not walk between them.",
  nothing_in_reach: "You may be outside of the scanned place. Go a few steps inside.",
  places_look_alike: "Go to where these places differ, such as a door or a corner, and look again.",
  turn_more: "Turn towards furniture, doors or pictures. Blank walls, floors and ceilings do not help.",
};
const ALWAYS = "More light helps, and a step away from the wall.";
const SIDES = ["straight ahead", "ahead to the left", "to your left", "behind you to the left", "behind you", "behind you to the right", "to your right", "ahead to the right"];

/** Return what may help where there is no sure place. */
export function adviceOf(answer: Answer, mapName: string): string[] {
  const found = (answer.reasons ?? []).flatMap((reason) => ADVICE[reason] ?? []);
  const more = answer.status === "ambiguous" ? [] : [ALWAYS, `Check that you are in “${mapName}”.`];
  return [...new Set([...found, ...more])];
}

/** Return how to get somewhere: metres away, and degrees counter-clockwise from where the phone looks. */
export function wayWords(metres: number, leftDeg: number): string {
  if (metres < 0.5) return "You stand there.";
  const side = SIDES[Math.round(((signed(leftDeg) + 360) % 360) / 45) % 8]!;
  return `${lengthWords(metres)} ${side}.`;
}

/** Return what a visitor can do about a map that cannot be shown. */
export function linkWords(problem: Problem, hasKey: boolean): { title: string; what: string } {
  const again = "Scan the code once more, or ask whoever put it up for a new one.";
  if (problem.status === 401 && !hasKey) return { title: "This link has no key", what: `The service asks for one. ${again}` };
  if (problem.status === 401) return { title: "The key of this link has ended", what: again };
  if (problem.status === 403) return { title: "The key of this link is not for phones", what: again };
  if (problem.status === 404) return { title: "There is no such map", what: `It was deleted, or the link is for another service. ${again}` };
  if (problem.status === 0 || problem.status >= 500 || problem.status === 429)
    return { title: "The service does not answer", what: "It is away or busy. Wait a minute, and look again." };
  return { title: problem.title, what: problem.detail };
}
