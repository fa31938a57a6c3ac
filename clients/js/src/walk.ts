/** The poses of a session, made one continuous walk: what a session calls its origin may jump, a person does not. */

import { compose, difference, IDENTITY, length, levelled, moved, scale, ZERO, type Difference, type Motion } from "./poses.ts";

/** Faster than people move, per second, beside what tracking corrects at once. */
const FASTEST_M = 4;
const FASTEST_RAD = 10;
const CORRECTED_M = 0.15;
const CORRECTED_RAD = 0.15;
/** How people move when nobody sees it: standard deviations, per second. */
const UNSEEN_M = 0.7;
const UNSEEN_RAD = 0.7;
/** Of that, what is left when tracking finds its place again by itself. */
const FOUND_AGAIN = 0.25;
const LONGEST_GAP_S = 0.25;

/** What a step of the walk leaves unknown: standard deviations of the pose of the camera. */
export interface Step {
  /** The session's origin did, so that poses before and after belong to different sessions. */
  jumped: boolean;
  step_m: number;
  turn_rad: number;
}

interface Seen {
  time_s: number;
  sessionFromCamera: Motion;
  perSecond: Difference;
}

export class Walk {
  /** Along the way, so far. */
  walked_m = 0;
  /** From the session as it is now to that of the first pose. */
  worldFromSession: Motion = IDENTITY;
  #last: Seen | null = null;
  #isReset = false;

  /** The pose of the camera at the last update. */
  get worldFromCamera(): Motion {
    return compose(this.worldFromSession, this.#last?.sessionFromCamera ?? IDENTITY);
  }

  /** When the camera was tracked last. */
  get seen_s(): number {
    return this.#last?.time_s ?? -Infinity;
  }

  /** The session's origin jumps with the next pose. */
  reset(): void {
    this.#isReset = true;
  }

  update(time_s: number, sessionFromCamera: Motion): Step {
    const { time_s: last_s, sessionFromCamera: before, perSecond } = this.#last ?? { time_s, sessionFromCamera, perSecond: { step_m: ZERO, turn_rad: ZERO } };
    const gap_s = time_s - last_s;
    const apart = difference(sessionFromCamera, before);
    const isTooFar = length(apart.step_m) > CORRECTED_M + FASTEST_M * gap_s || length(apart.turn_rad) > CORRECTED_RAD + FASTEST_RAD * gap_s;
    const jumped = this.#last !== null && (this.#isReset || isTooFar);
    this.#isReset = false;
    if (jumped) {
      // Until it is asked for: as if the person went on as before.
      const expected = moved(before, perSecond, Math.min(gap_s, LONGEST_GAP_S));
      this.worldFromSession = levelled(compose(this.worldFromSession, expected), sessionFromCamera);
    } else this.walked_m += length(apart.step_m);
    const pace = jumped || gap_s <= 0 ? perSecond : { step_m: scale(apart.step_m, 1 / gap_s), turn_rad: scale(apart.turn_rad, 1 / gap_s) };
    this.#last = { time_s, sessionFromCamera, perSecond: pace };
    const unseen_s = jumped ? gap_s : gap_s > LONGEST_GAP_S ? FOUND_AGAIN * gap_s : 0;
    return { jumped, step_m: UNSEEN_M * unseen_s, turn_rad: UNSEEN_RAD * unseen_s };
  }
}
