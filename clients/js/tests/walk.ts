/**
 * A walk with a tracker, in simulated time, against a real service: `node tests/walk.ts URL MAP FOLDER SEED …`.
 *
 * FOLDER: of tests/integration/walked_room.py. Prints as JSON, for each seed of the phone's drift, how far the tracker shows a point of
 * the map from where it is, at each frame after the first answer; null where it shows none.
 */

import { openAsBlob, readFileSync } from "node:fs";
import { join } from "node:path";
import { setImmediate } from "node:timers/promises";
import type { Query } from "../src/client.ts";
import { Panoloc, trackSession, type Localization, type Sending } from "../src/index.ts";
import { compose, difference, inverse, length, moved, rotationOf, scale, subtract, transform, ZERO, type Motion, type Vector } from "../src/poses.ts";
import { Phone, type Lens } from "./phone.ts";

interface Walked {
  camera: Lens;
  poses_per_s: number;
  frames: number[];
  map_from_camera: Motion[];
  anchor: Vector;
}

/** Of the phone's tracking: a share of the way, in a direction that turns by this per metre, and a turn per metre. */
const DRIFT = 0.01;
const WANDER_RAD_PER_M = 0.2;
const TURN_DRIFT_RAD_PER_M = (0.05 * Math.PI) / 180;
/** What an answer takes in simulated time, with the way there and back. */
const LATENCY_S = 0.5;

/** Return numbers between 0 and 1 that depend on nothing but the seed: Park and Miller's generator. */
function randomOf(seed: number): () => number {
  let state = 1000 + seed;
  const draw = (): number => (state = (state * 48271) % 2147483647) / 2147483647;
  for (let warm = 0; warm < 10; warm += 1) draw();
  return draw;
}

const turned = (angle: number, position_m = ZERO): Motion => ({ position_m, quaternion: rotationOf({ ...ZERO, y: angle }) });

/** Return `session_from_camera` as the phone tracks it, and the step at which the origin of its session jumps. */
function tracked(poses: readonly Motion[], seed: number): { sessionFromCamera: Motion[]; jump: number } {
  const draw = randomOf(seed);
  let heading = 2 * Math.PI * draw();
  const turn = Math.sign(draw() - 0.5) * TURN_DRIFT_RAD_PER_M;
  const jump = Math.floor(poses.length * (0.35 + 0.3 * draw()));
  const jumped = turned(6 * draw() - 3, { x: 8 * draw() - 4, y: 0, z: 8 * draw() - 4 });
  let here = turned(6 * draw() - 3, { x: 8 * draw() - 4, y: -0.5, z: 8 * draw() - 4 });
  const sessionFromCamera = poses.map((pose, step) => {
    const before = poses[step - 1] ?? pose;
    const next = compose(here, compose(step ? inverse(before) : turned(0), pose));
    const way_m = length(subtract(pose.position_m, before.position_m));
    heading += WANDER_RAD_PER_M * way_m;
    const direction = { x: 0.98 * Math.cos(heading), y: 0.2, z: 0.98 * Math.sin(heading) };
    here = moved(next, { step_m: scale(direction, DRIFT), turn_rad: { ...ZERO, y: turn } }, way_m);
    if (step === jump) here = compose(jumped, here);
    return here;
  });
  return { sessionFromCamera, jump };
}

/** A service whose answers come when simulated time has come. */
class LateService {
  time_s = 0;
  readonly took_s: number[] = [];
  readonly statuses: string[] = [];
  readonly #service: Panoloc;
  #waiting: { due_s: number; answered: Promise<unknown>; give: () => void }[] = [];

  constructor(service: Panoloc) {
    this.#service = service;
  }

  async localize(images: readonly Blob[], query: Query, sending?: Sending): Promise<Localization> {
    const began_ms = performance.now();
    const answered = this.#service.localize(images, query, sending);
    const given = new Promise<void>((give) => this.#waiting.push({ due_s: this.time_s + LATENCY_S, answered, give }));
    const answer = await answered;
    this.took_s.push((performance.now() - began_ms) / 1000);
    this.statuses.push(answer.status);
    await given;
    return answer;
  }

  /** Let time pass, and those answers come that are due. */
  async at(time_s: number): Promise<void> {
    this.time_s = time_s;
    await setImmediate();
    for (let next = this.#waiting[0]; next && next.due_s <= time_s; next = this.#waiting[0]) {
      this.#waiting.shift();
      await next.answered.catch(() => undefined);
      next.give();
      await setImmediate();
    }
  }
}

async function walk(service: Panoloc, mapId: string, walked: Walked, pictures: Map<number, Blob>, seed: number): Promise<object> {
  const { sessionFromCamera, jump } = tracked(walked.map_from_camera, seed);
  const late = new LateService(service);
  const phone = new Phone(walked.camera);
  const { session, space } = await phone.start();
  const tracker = trackSession(session, space, phone.gl, { service: late, mapId, now: () => late.time_s });
  const events: [string, number][] = [];
  const told = (name: string) => (): void => void events.push([name, late.time_s]);
  tracker.on("located", told("located"));
  tracker.on("corrected", told("corrected"));
  tracker.on("lost", told("lost"));
  tracker.on("error", (error) => events.push([String(error), late.time_s]));
  const errors: ({ m: number; deg: number } | null)[] = [];
  for (const [step, pose] of sessionFromCamera.entries()) {
    await late.at(step / walked.poses_per_s);
    phone.picture = pictures.get(step) ?? null;
    phone.show(pose, step === jump);
    if (!events.length) continue;
    const shown = tracker.sessionFromMap;
    const truth = compose(pose, inverse(walked.map_from_camera[step]!));
    errors.push(shown && {
      m: length(subtract(transform(shown, walked.anchor), transform(truth, walked.anchor))),
      deg: (length(difference(shown, truth).turn_rad) * 180) / Math.PI,
    });
  }
  tracker.stop();
  await phone.end();
  return { seed, jump_s: jump / walked.poses_per_s, events, errors, took_s: late.took_s, statuses: late.statuses };
}

const [url = "", mapId = "", folder = "", ...seeds] = process.argv.slice(2);
const walked = JSON.parse(readFileSync(join(folder, "walk.json"), "utf8")) as Walked;
const pictures = new Map<number, Blob>();
for (const step of walked.frames) pictures.set(step, await openAsBlob(join(folder, `${step}.jpg`), { type: "image/jpeg" }));
for (const seed of seeds) console.log(JSON.stringify(await walk(new Panoloc(url), mapId, walked, pictures, Number(seed))));
