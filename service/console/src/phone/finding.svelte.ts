/** From the first picture to a place: one is asked about at once, and together with others where it is not enough. */

import { RequestError, shown } from "../api/problem.ts";
import type { Answer, Problem } from "../api/types.ts";
import type { Upload } from "../api/upload.ts";
import { acrossLonger, ANY, Lenses } from "./lens.ts";
import { angleBetween, lookOf, type Quaternion } from "./orientation.ts";
import { ask, type TurnedShot } from "./query.ts";

export const MOST_SHOTS = 6;
/** From one picture to the next: they overlap no more than little. */
const APART_DEG = 38;
const SURE = 0.9;
const EXACT_M = 0.07;
/** Arms of unknown length keep several pictures from more. */
const EXACT_TOGETHER_M = 0.2;

const lenses = new Lenses(localStorage);

export class Finding {
  shots = $state.raw<TurnedShot[]>([]);
  isAsking = $state(false);
  answer = $state.raw<Answer | null>(null);
  /** The last picture that the answer is about: where the phone is now. */
  lastShot = $state.raw<TurnedShot | null>(null);
  problem = $state.raw<Problem | null>(null);
  private readonly mapId: string;
  private asked: Upload<Answer> | null = null;

  constructor(mapId: string) {
    this.mapId = mapId;
  }

  get isSure(): boolean {
    return this.answer !== null && isSure(this.answer);
  }

  /** Whether the last answer is what there is to say: sure, or no picture is to come. */
  get isOver(): boolean {
    return this.answer !== null && !this.isAsking && !this.wantsMore;
  }

  /** Whether the answers so far are not sure, and a picture in another direction can join the others. */
  get wantsMore(): boolean {
    return this.answer !== null && !this.isSure && this.canTurn;
  }

  private get canTurn(): boolean {
    return this.shots.length < MOST_SHOTS && this.shots.every((shot) => shot.orientation);
  }

  /** Which picture the last one that the answer is about is, from 1. */
  get lastNumber(): number {
    return this.lastShot ? this.shots.indexOf(this.lastShot) + 1 : 0;
  }

  isNewDirection(orientation: Quaternion): boolean {
    return this.shots.every((shot) => shot.orientation && angleBetween(lookOf(shot.orientation), lookOf(orientation)) >= APART_DEG);
  }

  /** Take a picture in, and ask; a picture that the others cannot be joined with replaces them. */
  async add(shot: TurnedShot): Promise<void> {
    // All have the same bounds across their width, which another size or a turned phone would change.
    const canJoin = this.canTurn && shot.orientation && shot.width === this.shots[0]?.width;
    this.shots = canJoin ? [...this.shots, shot] : [shot];
    if (this.isAsking) return;
    this.isAsking = true;
    this.problem = null;
    try {
      let shots: TurnedShot[];
      do {
        shots = this.shots;
        const last = shots.at(-1)!;
        const asked = shots.length === 1 ? this.askedAlone(last) : this.answered(ask(this.mapId, shots, lenses.range(last.lens)));
        this.answer = await asked;
        this.lastShot = last;
      } while (this.shots !== shots && !this.isSure);
    } catch (error) {
      if (!(error instanceof DOMException && error.name === "AbortError")) this.problem = shown(error);
    }
    this.isAsking = false;
  }

  restart(): void {
    this.asked?.cancel();
    this.shots = [];
    this.answer = this.lastShot = this.problem = null;
  }

  private async askedAlone(shot: TurnedShot): Promise<Answer> {
    if (shot.image instanceof File) {
      try {
        return await this.answered(ask(this.mapId, [shot], null));
      } catch (error) {
        if (!(error instanceof RequestError) || error.problem.status !== 422) throw error;
      }
    }
    const answer = this.learnt(shot, await this.answered(ask(this.mapId, [shot], lenses.range(shot.lens))));
    if (isSure(answer) || lenses.known(shot.lens) === null) return answer;
    // What was remembered may be what is wrong.
    const anew = await this.answered(ask(this.mapId, [shot], ANY));
    if (!isSure(anew)) return answer;
    lenses.forget(shot.lens);
    return this.learnt(shot, anew);
  }

  private async answered(asked: Upload<Answer>): Promise<Answer> {
    this.asked = asked;
    return asked.done;
  }

  /** Remember the field of view that a sure answer about one picture found. Of several it may only make up for the length of an arm. */
  private learnt(shot: TurnedShot, answer: Answer): Answer {
    const camera = answer.images[0]?.camera;
    if (isSure(answer) && camera) lenses.learn(shot.lens, acrossLonger(camera.hfov_deg, shot.width, shot.height));
    return answer;
  }
}

/** Whether an answer says exactly enough where somebody stands. */
function isSure(answer: Answer): boolean {
  const enough = answer.images.length > 1 ? EXACT_TOGETHER_M : EXACT_M;
  return rank(answer) >= SURE && (answer.accuracy?.position_m ?? Infinity) <= enough;
}

/** Return the confidence in a place, below 0 where there is none. */
function rank(answer: Answer): number {
  return answer.status === "localized" ? answer.confidence : answer.confidence - 1;
}
