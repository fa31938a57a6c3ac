/** The made-up room: made by the service, registered and searched as any other. */

import { getBlob, getJson } from "../api/service.ts";
import { RequestError } from "../api/problem.ts";
import type { Place } from "../api/types.ts";
import { maps } from "./maps.svelte.ts";
import { queries } from "./queries.svelte.ts";
import { go } from "./route.svelte.ts";
import { uploads } from "./uploads.svelte.ts";

export type DemoStep = "making" | "sending" | "building" | "localizing";

const PAUSE_MS = 700;

export async function showDemo(say: (step: DemoStep) => void): Promise<void> {
  say("making");
  const scan = new File([await getBlob("/demo/room.ply")], "demo-room.ply");
  const photo = new File([await getBlob("/demo/panorama.jpg")], "demo-panorama.jpg", { type: "image/jpeg" });
  say("sending");
  const begun = await uploads.begin(scan, { name: "Demo room", tags: ["demo"] });
  if (begun === null) return;
  say("building");
  const place = await ready(begun.id);
  say("localizing");
  queries.add([photo], { mapIds: [place.id], tag: "", hints: null, angle: null });
  go(`/maps/${place.id}`);
}

async function ready(id: string): Promise<Place> {
  for (;;) {
    const place = await getJson<Place>(`/maps/${id}`);
    maps.put(place);
    if (place.status === "ready") return place;
    if (place.status === "failed" && place.error) throw new RequestError(place.error);
    await new Promise((resolve) => setTimeout(resolve, PAUSE_MS));
  }
}
