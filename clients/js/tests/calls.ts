/** Every call of the client against a real service: `node calls.ts URL MAP PANORAMA`. */

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { Panoloc, PanolocError } from "../src/index.ts";

const [url = "", mapId = "", path = ""] = process.argv.slice(2);
const service = new Panoloc(url);
const photo = new File([readFileSync(path)], "panorama.jpg");

const ids: string[] = [];
for await (const { id } of service.maps.list()) ids.push(id);
assert.ok(ids.includes(mapId));
assert.equal((await service.maps.get(mapId)).status, "ready");

const sent = { idempotencyKey: `key-${Math.random()}` };
const query = { maps: mapId, options: { artifacts: ["overlay" as const], hints: { position_m: [0, 0, 0] as [number, number, number], radius_m: 50 } } };
const answer = await service.localize(photo, query, sent);
assert.equal((await service.localize(photo, query, sent)).id, answer.id);
assert.equal(answer.status, "localized");
assert.equal((await service.download(answer.artifacts["overlay"] ?? "")).type, "image/png");
await service.deleteLocalization(answer.id);
await assert.rejects(service.download(answer.artifacts["overlay"] ?? ""), { status: 404 });

const batch = await service.batches.create([photo], { maps: mapId });
const done = await service.batches.wait(batch.id);
assert.deepEqual(done.items.map(({ name, status }) => [name, status]), [["panorama.jpg", "localized"]]);
assert.ok((await service.batches.export(batch.id, "colmap")).size > 0);
await service.batches.delete(batch.id);

const scan = new Blob(["ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nend_header\n"]);
const copy = await service.maps.register(scan, "office.ply", {}, { onProgress: (share) => assert.equal(share, 1) });
assert.equal((await service.maps.wait(copy.id)).status, "failed");
await service.maps.delete(copy.id);
await assert.rejects(service.maps.get(copy.id), (error) => error instanceof PanolocError && error.status === 404 && error.requestId !== null);
