/** How many points a frame may have: measured while they are drawn, because machines differ by a factor of a thousand. */

const MOVING_MS = 36;
const STILL_MS = 900;
const FIRST_GUESS_PER_MS = 3000;
const LEAST_POINTS = 30_000;
/** Of a picture that stays: nobody waits for the next one. */
const LEAST_STILL_POINTS = 1_000_000;
/** A frame that waits for the screen says nothing of how long it took. */
const SHORTEST_MS = 20;

export class Pace {
  private perMs = FIRST_GUESS_PER_MS;
  private frames: number[] = [];

  get moving(): number {
    return Math.max(LEAST_POINTS, this.perMs * MOVING_MS);
  }

  /** Whether even few points take too long. */
  get isSlow(): boolean {
    return this.perMs * MOVING_MS < 4 * LEAST_POINTS;
  }

  get still(): number {
    return Math.max(LEAST_STILL_POINTS, this.perMs * STILL_MS);
  }

  /** Note a frame of a movement: how many points it had, how long after the one before it came. */
  note(numPoints: number, milliseconds: number): void {
    this.frames.push(milliseconds);
    if (this.frames.length > 60) this.frames.shift();
    const measured = numPoints / Math.max(milliseconds, 1);
    // Faster than the screen: more would be drawn in the same time.
    if (milliseconds < SHORTEST_MS) this.perMs = Math.max(this.perMs, Math.min(1.3 * this.perMs, 2 * measured));
    else this.perMs += (milliseconds > 4 * MOVING_MS ? 0.7 : 0.25) * (measured - this.perMs);
  }

  /** Frames per second of the last movement, for whoever measures. */
  get framesPerSecond(): number {
    const total = this.frames.reduce((sum, each) => sum + each, 0);
    return total > 0 ? (1000 * this.frames.length) / total : 0;
  }
}
