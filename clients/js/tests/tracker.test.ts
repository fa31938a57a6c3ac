import assert from "node:assert/strict";
import { setImmediate } from "node:timers/promises";
import { test } from "node:test";
import type { Query } from "../src/client.ts";
import { compose, difference, IDENTITY, length, rotationOf, subtract, ZERO, type Motion } from "../src/poses.ts";
import { Tracker, type Localization, type Sending } from "../src/index.ts";

const motion = (x: number, z: number, yaw = 0): Motion => ({ position_m: { x, y: 1.5, z }, quaternion: rotationOf({ ...ZERO, y: yaw }) });
const TRUTH = motion(3, -1, 1.2);
const localized = (map_from_session: Motion): Localization =>
  ({ status: "localized", map_from_session, accuracy: { position_m: 0.02, orientation_deg: 0.4, level: 0.68 } }) as never;
const unsure = (status: string): Localization => ({ status, map_from_session: motion(9, 9), accuracy: null }) as never;
const far = (a: Motion, b: Motion): number => length(subtract(a.position_m, b.position_m));

/** A person who walks at 1 m/s and turns, and a service that answers what it is told when it is told. */
class Walk {
  time_s = 0;
  numCaptured = 0;
  /** From the session that began to that of now. */
  origin: Motion = IDENTITY;
  readonly queries: { query: Query; signal: AbortSignal | undefined; give(answer: Localization): void; fail(error: unknown): void }[] = [];
  readonly events: string[] = [];
  readonly tracker: Tracker;

  constructor() {
    this.tracker = new Tracker({
      service: {
        localize: (_: readonly Blob[], query: Query, sending?: Sending) =>
          new Promise<Localization>((give, fail) => {
            this.queries.push({ query, signal: sending?.signal, give, fail });
            sending?.signal?.addEventListener("abort", () => fail(sending.signal?.reason));
          }),
      },
      mapId: "map_1",
      now: () => this.time_s,
      capture: () => {
        this.numCaptured += 1;
        return { image: new Blob(), camera: { model: "pinhole", hfov_deg: 69, session_from_camera: this.pose } };
      },
    });
    for (const name of ["located", "corrected", "lost", "error"] as const) this.tracker.on(name, () => this.events.push(name));
  }

  get worldFromCamera(): Motion {
    return motion(Math.sin(this.time_s), Math.cos(this.time_s), 1.3 * this.time_s);
  }

  get pose(): Motion {
    return compose(this.origin, this.worldFromCamera);
  }

  async go(seconds: number): Promise<void> {
    for (const end = this.time_s + seconds; this.time_s < end; this.time_s += 1 / 30) {
      this.tracker.update(this.pose);
      await setImmediate();
    }
  }

  /** Go on until there is a query, and answer it. */
  async answer(answer: Localization): Promise<void> {
    await this.go(3);
    assert.ok(this.queries.length, "expected a query within 3 s");
    this.queries.pop()?.give(answer);
    await setImmediate();
  }

  /** How far from the truth the camera is shown. */
  get error_m(): number {
    const { mapFromSession } = this.tracker;
    assert.ok(mapFromSession);
    return far(compose(mapFromSession, this.pose), compose(TRUTH, this.worldFromCamera));
  }
}

test("frames are collected in several directions, then asked about, one query at a time", async () => {
  const walk = new Walk();
  await walk.go(10);
  assert.equal(walk.queries.length, 1);
  assert.equal(walk.tracker.mapFromSession, null);
  const { maps, options } = walk.queries[0]!.query;
  assert.equal(maps, "map_1");
  assert.deepEqual([options?.frame, options?.method, options?.session, options?.hints?.prior], ["webxr", "fast", { up: "known" }, null]);
  const turns = options!.cameras!.map(({ session_from_camera }) => session_from_camera as Motion);
  assert.ok(turns.length >= 4 && turns.length <= 6, `${turns.length} frames`);
  for (const [number, pose] of turns.entries())
    for (const other of turns.slice(number + 1)) {
      const { step_m, turn_rad } = difference(pose, other);
      assert.ok(length(turn_rad) > 0.5 || length(step_m) > 0.5);
    }
});

test("an answer gives the map its place, and the next ones expect it there", async () => {
  const walk = new Walk();
  await walk.answer(localized(TRUTH));
  assert.deepEqual(walk.events, ["located"]);
  assert.ok(walk.error_m < 1e-6);
  assert.ok(far(compose(walk.tracker.sessionFromMap!, walk.tracker.mapFromSession!), IDENTITY) < 1e-9);
  await walk.go(2);
  const { options } = walk.queries[0]!.query;
  const prior = options!.hints!.prior!;
  const first = options!.cameras![0]!.session_from_camera as Motion;
  assert.ok(far(prior.pose!.map_from_camera, compose(TRUTH, first)) < 1e-6);
  assert.ok(prior.position_std_m! > 0.005 && prior.position_std_m! < 0.1, String(prior.position_std_m));
  await walk.answer(localized(TRUTH));
  assert.deepEqual(walk.events, ["located", "corrected"]);
});

test("answers that are not sure never move the map", async () => {
  const walk = new Walk();
  await walk.answer(unsure("ambiguous"));
  await walk.answer(unsure("not_localized"));
  assert.equal(walk.tracker.mapFromSession, null);
  await walk.answer(localized(TRUTH));
  for (const status of ["ambiguous", "not_localized", "ambiguous"]) await walk.answer(unsure(status));
  assert.deepEqual(walk.events, ["located"]);
  assert.ok(walk.error_m < 1e-6);
});

test("one answer that is far off does not move the map; a second that agrees with it does", async () => {
  const walk = new Walk();
  await walk.answer(localized(TRUTH));
  await walk.answer(localized(motion(0, 0)));
  assert.ok(walk.error_m < 1e-6);
  await walk.answer(localized(motion(-5, 2)));
  await walk.answer(localized(TRUTH));
  await walk.go(1);
  assert.ok(walk.error_m < 1e-3);
  assert.deepEqual(walk.events, ["located", "corrected"]);

  const wrong = new Walk();
  await wrong.answer(localized(motion(0, 0)));
  await wrong.answer(localized(TRUTH));
  assert.equal(wrong.queries.length, 0);
  await wrong.go(2);
  assert.equal(wrong.queries[0]!.query.options!.hints!.prior, null);
  await wrong.answer(localized(TRUTH));
  await wrong.go(1);
  assert.ok(wrong.error_m < 1e-3);
});

test("a correction is weighed and moves what is seen without a jump", async () => {
  const walk = new Walk();
  await walk.answer(localized(TRUTH));
  const moved = { ...TRUTH, position_m: { ...TRUTH.position_m, x: TRUTH.position_m.x + 0.03 } };
  await walk.go(3);
  let before = walk.error_m;
  walk.queries.pop()?.give(localized(moved));
  await setImmediate();
  for (let step = 0; step < 30; step += 1) {
    assert.ok(Math.abs(walk.error_m - before) < 0.01, `${before} to ${walk.error_m}`);
    before = walk.error_m;
    await walk.go(1 / 30);
  }
  assert.ok(walk.error_m > 0.01 && walk.error_m < 0.05, String(walk.error_m));
});

test("when the session's origin jumps, the map stays where it is for the user, and is asked for at once", async () => {
  for (const isTold of [true, false]) {
    const walk = new Walk();
    await walk.answer(localized(TRUTH));
    await walk.go(0.5);
    const under = walk.queries.pop();
    walk.origin = motion(4, -3, 2);
    if (isTold) walk.tracker.reset();
    assert.equal(walk.tracker.isDoubted, false);
    await walk.go(0.1);
    assert.equal(walk.tracker.isDoubted, true);
    assert.ok(walk.error_m < 0.05, String(walk.error_m));
    assert.ok(!under || under.signal?.aborted);
    await walk.go(1);
    assert.equal(walk.queries.length, 1);
    assert.deepEqual(walk.events, ["located"]);
  }
});

test("a jump after a time without tracking loses the map, until an answer finds it", async () => {
  const walk = new Walk();
  await walk.answer(localized(TRUTH));
  walk.tracker.update(null);
  walk.time_s += 4;
  walk.origin = motion(4, -3, 2);
  await walk.go(0.1);
  assert.deepEqual(walk.events, ["located", "lost"]);
  assert.equal(walk.tracker.mapFromSession, null);
  await walk.go(4);
  walk.queries.pop()!.give(localized(TRUTH));
  await setImmediate();
  assert.deepEqual(walk.events, ["located", "lost", "located"]);
});

test("the map is lost while there is no tracking, and not only when there is again", async () => {
  const walk = new Walk();
  await walk.answer(localized(TRUTH));
  walk.time_s += 2;
  walk.tracker.update(null);
  assert.deepEqual(walk.events, ["located"]);
  walk.time_s += 2;
  walk.tracker.update(null);
  walk.tracker.update(null);
  assert.deepEqual(walk.events, ["located", "lost"]);
});

test("a pose that is none is refused, and does no harm", async () => {
  const walk = new Walk();
  await walk.answer(localized(TRUTH));
  for (const broken of [motion(NaN, 0), motion(0, 0, NaN)]) assert.throws(() => walk.tracker.update(broken), /finite numbers/);
  await walk.go(1);
  assert.ok(walk.error_m < 0.01);
});

test("a camera that fails is told as an error, and the tracker goes on", async () => {
  const errors: unknown[] = [];
  const tracker = new Tracker({ service: { localize: () => Promise.reject(new Error("never")) }, mapId: "map_1", now: () => 1, capture: () => { throw new Error("no picture"); } });
  tracker.on("error", (error) => errors.push(error));
  tracker.update(IDENTITY);
  assert.match(String(errors[0]), /no picture/);
});

test("stopped, it ends the query that is under way, and asks and captures no more", async () => {
  const walk = new Walk();
  await walk.go(5);
  const { signal, give } = walk.queries.pop()!;
  walk.tracker.stop();
  assert.equal(signal?.aborted, true);
  give(localized(TRUTH));
  const { numCaptured } = walk;
  await walk.go(5);
  assert.deepEqual([walk.queries.length, walk.numCaptured, walk.events.length], [0, numCaptured, 0]);
  assert.equal(walk.tracker.mapFromSession, null);
});

test("a query without an answer is given up, and another one sent", async () => {
  const walk = new Walk();
  await walk.go(40);
  assert.deepEqual([walk.events, walk.queries.length, walk.queries[0]?.signal?.aborted], [["error"], 2, true]);
  walk.queries.pop()?.give(localized(TRUTH));
  await setImmediate();
  assert.deepEqual(walk.events, ["error", "located"]);
});

test("an error is told, and asking goes on more slowly", async () => {
  const walk = new Walk();
  await walk.go(3);
  walk.queries.pop()!.fail(new Error("away"));
  await walk.go(3);
  walk.queries.pop()!.fail(new Error("away"));
  await walk.go(2);
  assert.deepEqual([walk.events, walk.queries.length], [["error", "error"], 0]);
  await walk.go(3);
  assert.equal(walk.queries.length, 1);
});
