/** Photos on their way to an answer, and those that have one: two at a time, so that the first answers come early. */

import { RequestError, shown } from "../api/problem.ts";
import { getJson } from "../api/service.ts";
import type { Answer, PendingAnswer, Problem } from "../api/types.ts";
import { type Upload, upload } from "../api/upload.ts";
import { dropPhoto, keepPhoto, type KeptPhoto, keptPhotos, tab } from "./kept_photos.ts";
import { camerasOf, type ViewAngle } from "./view_angle.ts";

const AT_A_TIME = 2;
const PAUSE_MS = 400;
const NUM_POSES = 4;

export interface QueryHints {
  position_m?: [number, number, number];
  radius_m?: number;
  upright?: boolean;
}

export interface QueryTarget {
  mapIds: string[];
  tag: string;
  hints: QueryHints | null;
  angle: ViewAngle;
}

export class Query {
  readonly key: number;
  readonly photo: File;
  readonly target: QueryTarget;
  /** Whether it was there before the page was loaded. */
  readonly isOld: boolean;
  state = $state<"waiting" | "sending" | "searching" | "done" | "failed">("waiting");
  share = $state(0);
  answer = $state<Answer | null>(null);
  problem = $state<Problem | null>(null);
  private sending: Upload<PendingAnswer> | null = null;
  private isCancelled = false;

  constructor(photo: File, target: QueryTarget, key: number | null = null) {
    [this.photo, this.target, this.isOld] = [photo, target, key !== null];
    this.key = key ?? crypto.getRandomValues(new Uint32Array(1))[0]!;
  }

  async run(): Promise<void> {
    try {
      this.state = "sending";
      this.sending = upload<PendingAnswer>({
        path: "/localize",
        form: this.form(),
        headers: { Prefer: "respond-async" },
        onProgress: (share) => (this.share = share),
      });
      const { id } = await this.sending.done;
      void keepPhoto({ key: this.key, tab, at: Date.now(), photo: this.photo, target: JSON.parse(JSON.stringify(this.target)) as QueryTarget, answerId: id });
      await this.await(id);
    } catch (error) {
      this.problem = shown(error);
      this.state = "failed";
    }
  }

  /** Fetch the answer to a photo that was sent. */
  async await(answerId: string): Promise<void> {
    this.state = "searching";
    this.answer = await this.fetched(answerId);
    this.state = "done";
  }

  cancel(): void {
    this.isCancelled = true;
    this.sending?.cancel();
  }

  private form(): FormData {
    const form = new FormData();
    const { mapIds, tag, hints, angle } = this.target;
    const cameras = camerasOf(angle);
    const artifacts = ["score_map_2d", "score_map_3d", "overlay"];
    form.append("options", JSON.stringify({ artifacts, top_k: NUM_POSES, hints: hints ?? undefined, cameras }));
    if (tag) form.append("tag", tag);
    else for (const id of mapIds) form.append("map_id", id);
    form.append("image", this.photo, this.photo.name);
    return form;
  }

  private async fetched(id: string): Promise<Answer> {
    for (;;) {
      if (this.isCancelled) throw new DOMException("The query was cancelled.", "AbortError");
      let found: Answer | PendingAnswer | null = null;
      try {
        found = await getJson<Answer | PendingAnswer>(`/localizations/${encodeURIComponent(id)}`);
      } catch (error) {
        // A service that is away for a moment has the answer when it is back.
        if (shown(error).status !== 0 && shown(error).status !== 503) throw error;
      }
      if (found?.status === "failed") throw found.error ? new RequestError(found.error) : new Error("The query failed.");
      if (found && found.status !== "queued" && found.status !== "running") return found as Answer;
      await new Promise((resolve) => setTimeout(resolve, PAUSE_MS));
    }
  }
}

let items = $state<Query[]>([]);

export const queries = {
  get items(): Query[] {
    return items;
  },
  answered(answerId: string): Query | undefined {
    return items.find((query) => query.answer?.id === answerId);
  },
  ofMap(mapId: string): Query[] {
    return items.filter((query) => query.target.mapIds.includes(mapId) || query.answer?.map_id === mapId);
  },
  add(photos: File[], target: QueryTarget): Query[] {
    const added = photos.map((photo) => new Query(photo, target));
    items = [...added, ...items];
    pump();
    return added;
  },
  /** Send a photo once more; angle: of view, where another one than last time. */
  again(query: Query, angle: ViewAngle = query.target.angle): void {
    void queries.remove(query);
    queries.add([query.photo], { ...query.target, angle });
  },
  /** What the list no longer shows, a reload does not bring back. */
  async remove(...removed: Query[]): Promise<void> {
    for (const query of removed) query.cancel();
    await Promise.all(removed.map(({ key }) => dropPhoto(key)));
    items = items.filter((each) => !removed.includes(each));
  },
};

/** Show a photo again that was sent before the page was loaded; one whose answer the service has no longer is gone. */
async function restore({ photo, target, key, answerId }: KeptPhoto): Promise<void> {
  const query = new Query(photo, target, key);
  items = [...items, query];
  await query.await(answerId).catch(() => queries.remove(query));
}

void keptPhotos().then((kept) => kept.reverse().forEach((each) => void restore(each)));

function pump(): void {
  const underWay = items.filter((query) => query.state === "sending" || query.state === "searching").length;
  const next = items.filter((query) => query.state === "waiting").reverse().slice(0, Math.max(0, AT_A_TIME - underWay));
  for (const query of next) void query.run().finally(pump);
}
