/** How many points a frame may have: measured while they are drawn, because machines differ by a factor of a thousand. */

const MOVING_MS = 36;
const FIRST_GUESS_PER_MS = 3000;
const LEAST_POINTS = 8_000;
/** Of a part of a picture that stays, in milliseconds: short enough that a drag meanwhile begins at once. */
const STILL_MS = 100;
/** A frame that waits for the screen says nothing of how long it took. */
const SHORTEST_MS = 20;

export class Pace {
  private perMs = FIRST_GUESS_PER_MS;

  get moving(): number {
    return Math.floor(Math.max(LEAST_POINTS, this.perMs * MOVING_MS));
  }

  get still(): number {
    return Math.floor(Math.max(LEAST_POINTS, this.perMs * STILL_MS));
  }

  /** Note a frame of a movement: how many points it had, how long after the one before it came. */
  note(numPoints: number, milliseconds: number): void {
    const measured = numPoints / Math.max(milliseconds, 1);
    // Faster than the screen: more would be drawn in the same time.
    if (milliseconds < SHORTEST_MS) this.perMs = Math.max(this.perMs, Math.min(1.3 * this.perMs, 2 * measured));
    else this.perMs += (milliseconds > 4 * MOVING_MS ? 0.7 : 0.25) * (measured - this.perMs);
  }
}
