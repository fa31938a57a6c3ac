/**
 * The field of view of a camera, which browsers do not tell: the service finds it with the place. Degrees across the longer side of the
 * picture, so that they hold however the phone is turned.
 */

export type Range = [number, number];

/** Of the cameras of phones, in videos and photos. */
export const ANY: Range = [50, 92];
/** How far off a remembered one may be. */
const KNOWN_SHARE = 0.08;
const MOST_COUNTED = 8;

interface Known {
  deg: number;
  count: number;
}

export class Lenses {
  private readonly store: Storage;
  private readonly entry = "panoloc-lenses";

  constructor(store: Storage) {
    this.store = store;
  }

  /** Return the mean of what was found of a camera, null for none. */
  known(name: string): number | null {
    return this.all()[name]?.deg ?? null;
  }

  /** Return the bounds to search. */
  range(name: string): Range {
    const deg = this.known(name);
    return deg === null ? ANY : [deg * (1 - KNOWN_SHARE), deg * (1 + KNOWN_SHARE)];
  }

  /** Count what a sure answer found. */
  learn(name: string, deg: number): void {
    const all = this.all();
    const { deg: former, count } = all[name] ?? { deg: 0, count: 0 };
    all[name] = { deg: (former * count + deg) / (count + 1), count: Math.min(MOST_COUNTED, count + 1) };
    this.store.setItem(this.entry, JSON.stringify(all));
  }

  /** Forget a camera that an answer contradicts: it was zoomed, or is another one of that name. */
  forget(name: string): void {
    const all = this.all();
    delete all[name];
    this.store.setItem(this.entry, JSON.stringify(all));
  }

  private all(): Record<string, Known> {
    return JSON.parse(this.store.getItem(this.entry) ?? "{}") as Record<string, Known>;
  }
}

/** Return the field of view across the width of a picture, from that across its longer side. */
export function acrossWidth(deg: number, width: number, height: number): number {
  return scaled(deg, width / Math.max(width, height));
}

/** Return the field of view across the longer side of a picture, from that across its width. */
export function acrossLonger(deg: number, width: number, height: number): number {
  return scaled(deg, Math.max(width, height) / width);
}

function scaled(deg: number, factor: number): number {
  return (360 / Math.PI) * Math.atan(factor * Math.tan((deg * Math.PI) / 360));
}
