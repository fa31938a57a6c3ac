import assert from "node:assert/strict";
import { test } from "node:test";

import { Notes } from "../src/phone/ar/notes.ts";
import { ownPoint, pointAt, seenAt } from "../src/phone/ar/projection.ts";
import { arWords } from "../src/phone/ar.ts";
import { errorWords } from "../src/phone/ar/words.ts";
import { PanolocError, scanPoint, type View } from "../../../clients/js/src/index.ts";

/** A camera of 90 degrees across and 60 degrees up and down, its principal point a tenth of the width right of the middle. */
const P = [1, 0, 0, 0, 0, Math.sqrt(3), 0, 0, -0.2, 0, -1.002, -1, 0, 0, -0.2, 0];
/** Two metres east of the origin, a metre up, turned to the left by 90 degrees: it looks along −x. */
const POSE = { position: { x: 2, y: 1, z: 0 }, orientation: { x: 0, y: Math.SQRT1_2, z: 0, w: Math.SQRT1_2 } };
const VIEW: View = { projectionMatrix: P, transform: POSE };

function isNear(found: object | null, expected: Record<string, number>): void {
  assert.ok(found);
  for (const [name, value] of Object.entries(expected)) assert.ok(Math.abs((found as Record<string, number>)[name]! - value) < 1e-9, `${name}: ${JSON.stringify(found)}`);
}

test("a point straight ahead is seen at the principal point, others where a pinhole camera has them", () => {
  isNear(seenAt({ x: -1, y: 1, z: 0 }, VIEW), { left: 0.6, top: 0.5, distance_m: 3 });
  // Looking along −x, right is −z. Half of the width is as far to the side as ahead.
  isNear(seenAt({ x: 0, y: 1, z: -0.8 }, VIEW), { left: 0.8, top: 0.5, distance_m: Math.hypot(2, 0.8) });
  isNear(seenAt({ x: 0, y: 1 + 1 / Math.sqrt(3), z: 0 }, VIEW), { left: 0.6, top: 0.25 });
});

test("what is behind the camera or beside the view is not seen", () => {
  assert.equal(seenAt({ x: 4, y: 1, z: 0 }, VIEW), null);
  assert.equal(seenAt({ x: 0, y: 1, z: -2 }, VIEW), null);
  assert.equal(seenAt({ x: 0, y: 3, z: 0 }, VIEW), null);
});

test("a tapped point is at its distance from the camera, and seen where it was tapped", () => {
  isNear(pointAt({ left: 0.6, top: 0.5 }, 1, VIEW), { x: 1, y: 1, z: 0 });
  isNear(seenAt(pointAt({ left: 0.13, top: 0.92 }, 1, VIEW), VIEW), { left: 0.13, top: 0.92, distance_m: 1 });
});

test("notes have the axes of their scan", () => {
  assert.deepEqual(ownPoint({ x: 1, y: 2, z: 3 }), { x: 1, y: -3, z: 2 });
  assert.deepEqual(ownPoint(scanPoint(1.2, 0.4, 1.5)), { x: 1.2, y: 0.4, z: 1.5 });
});

function store(): Storage & { held: Map<string, string> } {
  const held = new Map<string, string>();
  const functions = { getItem: (name: string) => held.get(name) ?? null, setItem: (name: string, value: string) => void held.set(name, value), removeItem: (name: string) => void held.delete(name) };
  return { held, ...functions } as never;
}

test("notes are kept for their map and revision alone", () => {
  const kept = store();
  const at = { x: 1, y: 2, z: 3 };
  new Notes(kept, "map_1", 1).add("door", at);
  assert.deepEqual(new Notes(kept, "map_1", 1).add("lamp", at).map(({ text }) => text), ["door", "lamp"]);
  assert.deepEqual(new Notes(kept, "map_1", 1).all()[0], { id: 1, text: "door", position_m: at });
  assert.deepEqual(new Notes(kept, "map_1", 2).all(), []);
  assert.deepEqual(new Notes(kept, "map_2", 1).all(), []);
});

test("a deleted note is gone and the others stay; after the last nothing is kept", () => {
  const kept = store();
  const notes = new Notes(kept, "map_1", 1);
  for (const text of ["door", "lamp", "desk"]) notes.add(text, { x: 0, y: 0, z: 0 });
  assert.deepEqual(notes.remove(2).map(({ text }) => text), ["door", "desk"]);
  assert.equal(notes.add("bed", { x: 0, y: 0, z: 0 }).at(-1)?.id, 4);
  for (const { id } of notes.all()) notes.remove(id);
  assert.equal(kept.held.size, 0);
});

test("who gets no AR or no answer reads why in plain words", () => {
  assert.match(arWords(new DOMException("", "NotAllowedError")), /may not use the camera/);
  assert.match(arWords(new DOMException("", "NotSupportedError")), /has no AR/);
  assert.match(arWords(new Error("…")), /cannot be started/);
  assert.match(errorWords(new PanolocError({ status: 0, detail: "…" }), true), /^There is no answer/);
  assert.match(errorWords(new Error("no answer within 30 s"), true), /^There is no answer/);
  assert.match(errorWords(new PanolocError({ status: 401, detail: "…" }), true), /The key of this link has ended/);
  assert.match(errorWords(new PanolocError({ status: 503, title: "Busy", detail: "Too many queries." }), true), /does not answer/);
});
