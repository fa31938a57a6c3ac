import type { Alternative, Answer } from "../api/types.ts";

/** Less likely ones beside an answer that is sure are no news. */
const LEAST_CONFIDENCE = 0.01;

/** Return the poses of an answer in one map, likeliest first: the found one, and others that may be right. */
export function posesIn(answer: Answer, mapId: string): Alternative[] {
  const found = answer.pose && answer.map_id === mapId ? [{ pose: answer.pose, confidence: answer.confidence, map_id: mapId }] : [];
  const others = answer.alternatives.filter((each) => each.map_id === mapId && (answer.status !== "localized" || each.confidence >= LEAST_CONFIDENCE));
  return [...found, ...others];
}

/** Return the other maps in which a photo may have been taken, the likeliest first, each with its best confidence. */
export function otherMaps(answer: Answer, mapId: string): { mapId: string; confidence: number }[] {
  const ids = new Set([...(answer.pose && answer.map_id ? [answer.map_id] : []), ...answer.alternatives.map((each) => each.map_id)]);
  ids.delete(mapId);
  return [...ids]
    .map((id) => ({ mapId: id, confidence: Math.max(0, ...posesIn(answer, id).map((each) => each.confidence)) }))
    .filter((each) => each.confidence >= LEAST_CONFIDENCE)
    .sort((a, b) => b.confidence - a.confidence);
}
