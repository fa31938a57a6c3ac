/** Order of names as people count: `pano_2` before `pano_19`. */

const collator = new Intl.Collator(undefined, { numeric: true, sensitivity: "base" });

export function naturally<T extends { name: string }>(items: readonly T[]): T[] {
  return [...items].sort((a, b) => collator.compare(a.name, b.name));
}
