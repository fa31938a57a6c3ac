/** Keeps `mapFromSession` right while a person walks: asks the service from time to time, and weighs what it answers. */

import { areApart, first, fused, later, loosened, measured, type Estimate } from "./estimate.ts";
import { compose, difference, inverse, isFiniteMotion, length, moved, type Difference, type Motion } from "./poses.ts";
import type { Query } from "./client.ts";
import type { Sending } from "./requests.ts";
import type { CameraEntry, LocalizeOptions, Localization, Localized } from "./types.ts";
import { Walk } from "./walk.ts";

/** An image with its camera: intrinsics and `session_from_camera`, in the axes of WebXR. */
export interface Frame {
  image: Blob | Promise<Blob>;
  camera: CameraEntry & { session_from_camera: Motion };
}

export interface TrackerSettings {
  service: { localize(images: readonly Blob[], query: Query, sending?: Sending): Promise<Localization> };
  mapId: string;
  /** Return what the camera sees now; null where it has no image. Called within `update`. */
  capture(): Frame | null;
  /** Of every query, such as `hints`. */
  options?: LocalizeOptions;
  /** Seconds; default: the clock of the page. */
  now?: () => number;
}

export interface TrackerEvents {
  /** The map has its place, for the first time or anew. */
  located: Localized;
  /** An answer has moved it a little. */
  corrected: Localized;
  /** Its place is not known any more; `mapFromSession` is null. */
  lost: null;
  /** Every answer: `status` and `reasons` say what to ask of the user. */
  answer: Localization;
  error: unknown;
}

type Listeners = { [Name in keyof TrackerEvents]: Set<(event: TrackerEvents[Name]) => void> };

interface Kept extends Omit<Frame, "camera"> {
  camera: Frame["camera"];
  worldFromCamera: Motion;
  walked_m: number;
  time_s: number;
}

/** What the user sees moves by this, away from what was seen before. */
interface Blend {
  began_s: number;
  worldFromCamera: Motion;
  left: Difference;
}

const MOST_FRAMES = 6;
/** A frame is new when the camera has turned or moved by so much since every other. */
const NEW_TURN_RAD = Math.PI / 6;
const NEW_STEP_M = 0.5;
const FRAME_PAUSE_S = 0.3;
/** Frames of one query: those since which the drift is small, and not a long time has passed. */
const FRAMES_WITHIN_M = 3;
const FRAMES_WITHIN_S = 10;
/** With fewer frames than the most, the first query waits for others this long. */
const COLLECT_S = 2.5;
const ASK_EVERY_M = 1;
const ASK_EVERY_S = 5;
const LEAST_PAUSE_S = 1;
const LONGEST_PAUSE_S = 30;
const LONGEST_QUERY_S = 30;
const BLEND_S = 0.4;
const LONGEST_LOSS_S = 3;
/** The map is lost when its place is less sure than this. */
const LOST_M = 0.5;
const LOST_RAD = 0.35;

export class Tracker {
  readonly #settings: TrackerSettings;
  readonly #now: () => number;
  readonly #listeners: Listeners = { located: new Set(), corrected: new Set(), lost: new Set(), answer: new Set(), error: new Set() };
  #walk = new Walk();
  #frames: Kept[] = [];
  #estimate: Estimate | null = null;
  #doubted: Estimate | null = null;
  #blend: Blend | null = null;
  #query: AbortController | null = null;
  #isUrgent = false;
  /** The origin has jumped, and no answer has said since where the map is. */
  #hasJumped = false;
  #isStopped = false;
  #numErrors = 0;
  #asked = { time_s: -Infinity, walked_m: -Infinity };

  constructor(settings: TrackerSettings) {
    this.#settings = settings;
    this.#now = settings.now ?? (() => performance.now() / 1000);
  }

  /** Call a function at each event; returns what ends that. */
  on<Name extends keyof TrackerEvents>(name: Name, listener: (event: TrackerEvents[Name]) => void): () => void {
    this.#listeners[name].add(listener);
    return () => void this.#listeners[name].delete(listener);
  }

  /** Where the session lies in the map now, both with y up; null while that is not known. */
  get mapFromSession(): Motion | null {
    return this.#estimate && compose(this.#shown(this.#estimate), this.#walk.worldFromSession);
  }

  /** Whether the next answer may move the map far: the session's origin has jumped, or an answer has contradicted what is known. */
  get isDoubted(): boolean {
    return this.#hasJumped || this.#doubted !== null;
  }

  /** Where the map lies in the session: content of the map is to be drawn there. */
  get sessionFromMap(): Motion | null {
    const found = this.mapFromSession;
    return found && inverse(found);
  }

  /** Call in every frame of the session with the pose of the camera in it, or with null while that is not tracked. */
  update(sessionFromCamera: Motion | null): void {
    if (this.#isStopped) return;
    const time_s = this.#now();
    if (!sessionFromCamera) {
      if (this.#estimate && time_s - this.#walk.seen_s > LONGEST_LOSS_S) this.#lose();
      return;
    }
    if (!isFiniteMotion(sessionFromCamera)) throw new TypeError("expected a pose of finite numbers, or null while the camera is not tracked");
    const step = this.#walk.update(time_s, sessionFromCamera);
    if (step.jumped) {
      this.#hasJumped = true;
      this.#forget();
    }
    if (this.#estimate) {
      this.#estimate = loosened(this.#estimate, step.step_m, step.turn_rad);
      if (step.step_m > 0) this.#isUrgent = true;
      const { position_m, yaw_rad } = later(this.#estimate, this.#walk.walked_m);
      if (position_m > LOST_M || yaw_rad > LOST_RAD) this.#lose();
    }
    if (this.#query && time_s - this.#asked.time_s > LONGEST_QUERY_S) this.#query.abort(new Error(`no answer within ${LONGEST_QUERY_S} s`));
    this.#collect(time_s);
    if (this.#isTimeToAsk(time_s)) void this.#ask(time_s);
  }

  get isStopped(): boolean {
    return this.#isStopped;
  }

  /** Call when the origin of the session jumps: at the event `reset` of an XRReferenceSpace. */
  reset(): void {
    this.#walk.reset();
  }

  /** End the query that is under way, and ask no more. */
  stop(): void {
    this.#isStopped = true;
    this.#forget();
  }

  #emit<Name extends keyof TrackerEvents>(name: Name, event: TrackerEvents[Name]): void {
    for (const listener of this.#listeners[name]) listener(event);
  }

  #forget(): void {
    this.#query?.abort();
    this.#query = null;
    this.#frames = [];
    this.#doubted = null;
  }

  #lose(): void {
    this.#forget();
    this.#estimate = this.#blend = null;
    this.#emit("lost", null);
  }

  #collect(time_s: number): void {
    const { walked_m, worldFromSession, worldFromCamera } = this.#walk;
    this.#frames = this.#frames.filter((frame) => walked_m - frame.walked_m < FRAMES_WITHIN_M && time_s - frame.time_s < FRAMES_WITHIN_S);
    const newest = this.#frames.at(-1);
    if (newest && time_s - newest.time_s < FRAME_PAUSE_S) return;
    const isNew = this.#frames.every((frame) => {
      const { step_m, turn_rad } = difference(worldFromCamera, frame.worldFromCamera);
      return length(step_m) > NEW_STEP_M || length(turn_rad) > NEW_TURN_RAD;
    });
    const taken = isNew ? this.#captured() : null;
    if (!taken) return;
    // A picture that cannot be made is told when it is sent.
    if (taken.image instanceof Promise) taken.image.catch(() => undefined);
    const seen = compose(worldFromSession, taken.camera.session_from_camera);
    this.#frames = [...this.#frames, { ...taken, worldFromCamera: seen, walked_m, time_s }].slice(-MOST_FRAMES);
  }

  #captured(): Frame | null {
    try {
      return this.#settings.capture();
    } catch (error) {
      this.#emit("error", error);
      return null;
    }
  }

  #isTimeToAsk(time_s: number): boolean {
    const { time_s: asked_s, walked_m } = this.#asked;
    const first = this.#frames[0];
    const newest = this.#frames.at(-1);
    if (this.#query || !first || !newest || newest.time_s <= asked_s) return false;
    if (time_s - asked_s < Math.min(LEAST_PAUSE_S * 2 ** this.#numErrors, LONGEST_PAUSE_S)) return false;
    if (this.#isUrgent || this.#doubted) return true;
    if (!this.#estimate) return this.#frames.length === MOST_FRAMES || time_s - first.time_s >= COLLECT_S;
    return this.#walk.walked_m - walked_m >= ASK_EVERY_M || time_s - asked_s >= ASK_EVERY_S;
  }

  async #ask(time_s: number): Promise<void> {
    const query = (this.#query = new AbortController());
    const frames = this.#frames.toReversed();
    this.#asked = { time_s, walked_m: this.#walk.walked_m };
    this.#isUrgent = false;
    try {
      const images = await Promise.all(frames.map(({ image }) => image));
      const answer = await this.#settings.service.localize(images, { maps: this.#settings.mapId, options: this.#optionsOf(frames) }, { signal: query.signal });
      if (this.#query !== query) return;
      this.#numErrors = 0;
      this.#emit("answer", answer);
      if (answer.status === "localized") this.#take(answer, frames);
    } catch (error) {
      if (this.#query !== query) return;
      this.#numErrors += 1;
      this.#emit("error", error);
    } finally {
      if (this.#query === query) this.#query = null;
    }
  }

  #optionsOf(frames: readonly Kept[]): LocalizeOptions {
    const { options } = this.#settings;
    const cameras = frames.map(({ camera, worldFromCamera }) => ({ ...camera, session_from_camera: worldFromCamera }));
    const hints = { ...options?.hints, prior: this.#prior(frames[0]) };
    return { session: { up: "known" }, ...options, frame: "webxr", method: "fast", cameras, hints };
  }

  /** Where the first image is expected. Not while that is in doubt: the service looks there first. */
  #prior(frame: Kept | undefined): { pose: { frame: "webxr"; map_from_camera: Motion }; position_std_m: number; orientation_std_deg: number } | null {
    if (!this.#estimate || !frame || this.#doubted) return null;
    const { mapFromSession, position_m, yaw_rad } = later(this.#estimate, this.#walk.walked_m);
    const map_from_camera = compose(mapFromSession, frame.worldFromCamera);
    return { pose: { frame: "webxr", map_from_camera }, position_std_m: position_m, orientation_std_deg: (yaw_rad * 180) / Math.PI };
  }

  #take(answer: Localized, frames: readonly Kept[]): void {
    // The answer holds for the images, of which the first is its pose's.
    const camera = frames[0]?.worldFromCamera ?? this.#walk.worldFromCamera;
    const walked_m = frames.reduce((sum, frame) => sum + frame.walked_m, 0) / frames.length;
    const found = measured(answer.map_from_session, answer.accuracy, walked_m);
    const known = this.#estimate && later(this.#estimate, walked_m);
    const doubted = this.#doubted && later(this.#doubted, walked_m);
    if (!known) {
      this.#show(first(found, camera));
      this.#emit("located", answer);
    } else if (!areApart(known, found, camera)) {
      this.#show(fused(known, found, camera));
      this.#emit("corrected", answer);
    } else if (doubted && !areApart(doubted, found, camera)) {
      this.#show(fused(first(doubted, camera), found, camera));
      this.#emit("located", answer);
    } else {
      // One of both is wrong: an answer to other images decides.
      this.#doubted = found;
      this.#frames = [];
    }
  }

  /** Take an estimate. What is seen moves there, from where it was. */
  #show(estimate: Estimate): void {
    const { worldFromCamera } = this.#walk;
    if (this.#estimate) {
      const seen = compose(this.#shown(this.#estimate), worldFromCamera);
      const left = difference(seen, compose(later(estimate, this.#walk.walked_m).mapFromSession, worldFromCamera));
      this.#blend = { began_s: this.#now(), worldFromCamera, left };
    }
    this.#estimate = estimate;
    this.#doubted = null;
    this.#hasJumped = false;
  }

  /** Return what is seen now of an estimate. */
  #shown(estimate: Estimate): Motion {
    const { mapFromSession } = later(estimate, this.#walk.walked_m);
    if (!this.#blend) return mapFromSession;
    const { began_s, worldFromCamera, left } = this.#blend;
    const share = Math.min((this.#now() - began_s) / BLEND_S, 1);
    const mapFromCamera = moved(compose(mapFromSession, worldFromCamera), left, 1 - share * share * (3 - 2 * share));
    return compose(mapFromCamera, inverse(worldFromCamera));
  }
}
