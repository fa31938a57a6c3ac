import assert from "node:assert/strict";
import { test } from "node:test";

import { acrossLonger, acrossWidth, ANY, Lenses } from "../src/phone/lens.ts";
import { wayWords } from "../src/phone/words.ts";

function store(): Storage {
  const held = new Map<string, string>();
  return { getItem: (name: string) => held.get(name) ?? null, setItem: (name: string, value: string) => void held.set(name, value) } as unknown as Storage;
}

test("a phone held upright has the narrower field of view across its width", () => {
  assert.ok(Math.abs(acrossWidth(69, 720, 1280) - 42.2726) < 1e-3);
  assert.equal(acrossWidth(69, 1280, 720), 69);
  assert.ok(Math.abs(acrossLonger(acrossWidth(69, 720, 1280), 720, 1280) - 69) < 1e-9);
});

test("a camera that was found once is searched around that, a forgotten one as an unknown one", () => {
  const kept = store();
  const lenses = new Lenses(kept);
  assert.deepEqual(lenses.range("back 1920x1080"), ANY);
  lenses.learn("back 1920x1080", 68);
  lenses.learn("back 1920x1080", 70);
  assert.equal(new Lenses(kept).known("back 1920x1080"), 69);
  const [least, most] = lenses.range("back 1920x1080");
  assert.ok(least > 60 && least < 66 && most > 72 && most < 78);
  assert.equal(lenses.known("front 1920x1080"), null);
  lenses.forget("back 1920x1080");
  assert.deepEqual(lenses.range("back 1920x1080"), ANY);
});

test("the way is said as somebody sees it who looks where the phone looks", () => {
  assert.equal(wayWords(3.24, 5), "3.2 m straight ahead.");
  assert.equal(wayWords(3.24, 90), "3.2 m to your left.");
  assert.equal(wayWords(12, -100), "12 m to your right.");
  assert.equal(wayWords(12, 540), "12 m behind you.");
  assert.equal(wayWords(0.2, 0), "You stand there.");
});
