/** How fine the pictures of a movement are, so that they come in time where the processor draws them. */

/** Between two pictures, milliseconds: 25 a second, and some to spare. */
const [TOO_LONG_MS, SHORT_MS] = [40, 28];
const [COARSEST, FINEST] = [0.25, 1];
/** So many that surfaces close with points of two pixels. Fewer but larger ones would cost as much: what takes time are the pixels. */
const POINTS_PER_PIXEL = 0.4;
/** Pictures of which the middle one counts: a machine that did something else for a moment is not a slow one. */
const LOOKED_BACK = 5;

export class ProcessorPace {
  /** Pixels of a picture per pixel of the page, along each side. */
  fineness = 0.6;
  private latest: number[] = [];

  /** Points of a picture of so many pixels. */
  numPoints(numPixels: number): number {
    return Math.ceil(POINTS_PER_PIXEL * numPixels);
  }

  /** Note how long after the one before it a picture came. */
  note(milliseconds: number): void {
    this.latest = [...this.latest, milliseconds].slice(-LOOKED_BACK);
    const middle = this.latest.toSorted((a, b) => a - b)[this.latest.length >> 1]!;
    if (middle > TOO_LONG_MS) this.fineness = Math.max(COARSEST, 0.94 * this.fineness);
    else if (middle < SHORT_MS) this.fineness = Math.min(FINEST, 1.03 * this.fineness);
  }
}
