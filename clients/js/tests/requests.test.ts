import assert from "node:assert/strict";
import { createServer, type IncomingMessage, type Server, type ServerResponse } from "node:http";
import type { AddressInfo } from "node:net";
import { after, before, beforeEach, test } from "node:test";
import { Panoloc, PanolocError } from "../src/index.ts";

type Reply = (request: IncomingMessage, response: ServerResponse) => void;

const json = (status: number, body: object, headers = {}): Reply => (_, response) =>
  response.writeHead(status, { "Content-Type": "application/json", ...headers }).end(JSON.stringify(body));
const busy = json(429, { type: "/problems/queue-full", title: "Busy", detail: "the queue is full", request_id: "req_1" }, { "Retry-After": "0.01" });
const hangUp: Reply = (_, response) => response.destroy();
const answer = json(200, { status: "not_localized", id: "loc_1" });

let server: Server;
let url: string;
let replies: Reply[] = [];
let requests: IncomingMessage[] = [];

before(async () => {
  server = createServer((request, response) => {
    requests.push(request);
    request.resume().on("end", () => replies.shift()?.(request, response)).on("error", () => undefined);
  });
  await new Promise<void>((ready) => server.listen(0, "127.0.0.1", ready));
  url = `http://127.0.0.1:${(server.address() as AddressInfo).port}`;
});
after(() => {
  server.closeAllConnections();
  server.close();
});
beforeEach(() => {
  replies = [];
  requests = [];
});

const localize = (service: Panoloc, signal?: AbortSignal) => service.localize(new Blob(["jpeg"]), { maps: "map_1" }, { signal });
const keys = () => requests.map(({ headers }) => headers["idempotency-key"]);

test("a query that is put off or lost is sent again as the same one", async () => {
  replies = [busy, hangUp, json(409, { type: "/problems/request-under-way", detail: "wait" }, { "Retry-After": "0.01" }), answer];
  assert.equal((await localize(new Panoloc(`${url}/`, { key: "secret" }))).id, "loc_1");
  assert.equal(requests.length, 4);
  assert.equal(new Set(keys()).size, 1);
  assert.equal(requests[0]?.headers.authorization, "Bearer secret");
  assert.equal(requests[0]?.url, "/localize");
  replies = [answer];
  await localize(new Panoloc(url));
  assert.notEqual(keys().at(-1), keys()[0]);
});

test("a query need not name maps", async () => {
  replies = [answer];
  assert.equal((await new Panoloc(url).localize(new Blob(["jpeg"]))).id, "loc_1");
});

test("what is refused is an error with the words of the service", async () => {
  replies = [json(422, { type: "/problems/invalid-options", title: "Invalid", detail: "top_k: expected 1 to 20", request_id: "req_7" })];
  await assert.rejects(localize(new Panoloc(url)), (error) => {
    assert.ok(error instanceof PanolocError);
    const { status, type, title, detail, requestId } = error;
    assert.deepEqual([status, type, title, detail, requestId], [422, "/problems/invalid-options", "Invalid", "top_k: expected 1 to 20", "req_7"]);
    return true;
  });
  replies = [json(409, { type: "/problems/request-under-way", detail: "of somebody else" })];
  await assert.rejects(localize(new Panoloc(url)), { status: 409 });
  assert.equal(requests.length, 2);
});

test("a page of a proxy is an error too", async () => {
  replies = [(_, response) => response.writeHead(502).end("<html>")];
  await assert.rejects(localize(new Panoloc(url)), { status: 502, type: "about:blank", message: "The service answered with status 502." });
});

test("it gives up after as many tries as it was told", async () => {
  replies = [busy, busy, answer];
  await assert.rejects(localize(new Panoloc(url, { retries: 1 })), { status: 429, title: "Busy" });
  replies = [hangUp];
  await assert.rejects(localize(new Panoloc(url, { retries: 0 })), { status: 0, type: "unreachable", message: /fetch failed \(.+\)$/ });
});

test("a signal ends a request and a wait with its reason", async () => {
  const reason = new Error("enough");
  for (const reply of [() => undefined, json(503, { detail: "later" }, { "Retry-After": "60" })]) {
    replies = [reply];
    await assert.rejects(localize(new Panoloc(url), AbortSignal.timeout(50)), { name: "TimeoutError" });
  }
  await assert.rejects(localize(new Panoloc(url), AbortSignal.abort(reason)), reason);
});

test("maps are listed page by page, and waited for", async () => {
  replies = [json(200, { items: [{ id: "a" }], next_cursor: "n" }), json(200, { items: [{ id: "b" }], next_cursor: null })];
  const service = new Panoloc(url);
  const ids: string[] = [];
  for await (const { id } of service.maps.list("floor")) ids.push(id);
  assert.deepEqual(ids, ["a", "b"]);
  assert.deepEqual(requests.map((request) => request.url), ["/maps?tag=floor", "/maps?tag=floor&cursor=n"]);
  replies = [json(200, { status: "reading" }), json(200, { status: "ready" })];
  const seen: string[] = [];
  await service.maps.wait("a", ({ status }) => seen.push(status));
  assert.deepEqual(seen, ["reading", "ready"]);
});

test("where the browser tells how much has left, so does the client", async () => {
  class FakeRequest {
    upload: { onprogress?: (event: object) => void } = {};
    status = 202;
    response = new Blob(['{"id": "map_1"}']);
    headers: Record<string, string> = {};
    onload = (): void => undefined;
    open(...given: string[]): void {
      assert.deepEqual(given, ["POST", `${url}/maps`]);
    }
    setRequestHeader(name: string, value: string): void {
      this.headers[name] = value;
    }
    getAllResponseHeaders = (): string => "location: /maps/map_1\r\nretry-after: 1\r\n";
    send(): void {
      assert.ok(this.headers["idempotency-key"]);
      this.upload.onprogress?.({ lengthComputable: true, loaded: 1, total: 4 });
      this.onload();
    }
  }
  Object.assign(globalThis, { XMLHttpRequest: FakeRequest });
  try {
    const shares: number[] = [];
    const map = await new Panoloc(url).maps.register(new Blob(["ply"]), "office.ply", { unit: "mm" }, { onProgress: (share) => shares.push(share) });
    assert.deepEqual([map.id, shares], ["map_1", [0.25]]);
  } finally {
    Reflect.deleteProperty(globalThis, "XMLHttpRequest");
  }
});

test("what cannot be meant is refused at once, without a request", async () => {
  for (const url of ["", "127.0.0.1:8000", "nonsense", "ftp://a"]) assert.throws(() => new Panoloc(url), /expected the address/);
  assert.throws(() => new Panoloc("http://a", { key: "a\nb" }), /expected a key/);
  const service = new Panoloc("http://127.0.0.1:9");
  await assert.rejects(service.maps.get(""), /expected an id/);
  await assert.rejects(service.maps.wait(""), /expected an id/);
  await assert.rejects(service.localize("photo.jpg" as never, { maps: "map_1" }), /expected images as Blobs/);
  const hints = { heading_deg: 0 / 0 };
  await assert.rejects(service.localize(new Blob(), { maps: "map_1", options: { hints } }), /finite numbers in options, got NaN as heading_deg/);
});
