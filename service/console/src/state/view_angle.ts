/** The horizontal angle of view of ordinary photos: what their EXIF data say, degrees, or bounds within which it is searched. */

export type ViewAngle = null | number | [number, number];

/** Return `cameras` of the options of a query; undefined where each photo says so itself. */
export function camerasOf(angle: ViewAngle): Record<string, unknown>[] | undefined {
  if (angle === null) return undefined;
  return [{ model: "pinhole", unless_panorama: true, ...(Array.isArray(angle) ? { hfov_range_deg: angle } : { hfov_deg: angle }) }];
}

export function angleWords(angle: ViewAngle): string {
  if (angle === null) return "from EXIF";
  return Array.isArray(angle) ? `${angle[0]}° to ${angle[1]}°` : `${angle}°`;
}
