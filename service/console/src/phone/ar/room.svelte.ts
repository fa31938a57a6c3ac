/** A room in which somebody looks around: where its map is, and where its notes are seen in each frame. */

import { inverse, type Localized, type Motion, Panoloc, scanPoint, type Tracker, trackSession, transform, type Vector } from "../../../../../clients/js/src/index.ts";
import { key } from "../../api/key.svelte.ts";
import { relative } from "../../api/service.ts";
import { adviceOf } from "../words.ts";
import { type Note, Notes } from "./notes.ts";
import { ownPoint, pointAt, type Seen, seenAt, type Spot } from "./projection.ts";
import { errorWords, FOUND, LOOKING, LOST, UNTRACKED } from "./words.ts";

const DISTANCE_M = 1;
const MIDDLE: Spot = { left: 0.5, top: 0.5 };

export class Room {
  /** Whether notes can be shown now; and left, for which it must be sure where they are. */
  isLocated = $state(false);
  canLeave = $state(false);
  /** Every note; while it is written, the new one as well. */
  notes = $state.raw<Note[]>([]);
  seen = $state.raw<(Note & Seen)[]>([]);
  /** Where the note is that is being written, in the map's own frame. */
  draft = $state.raw<Vector | null>(null);
  private isTracked = $state(true);
  private news = $state(LOOKING);
  private kept: Notes | null = null;
  private now: { view: XRView; sessionFromMap: Motion } | null = null;

  get said(): string {
    return this.isTracked ? this.news : UNTRACKED;
  }

  /** Follow a session until it ends. */
  async follow(session: XRSession, mapId: string): Promise<void> {
    const gl = document.createElement("canvas").getContext("webgl2", { xrCompatible: true });
    if (gl === null) throw new Error("expected WebGL 2 of the browser, got none");
    const layer = new XRWebGLLayer(session, gl);
    await session.updateRenderState({ baseLayer: layer });
    const space = await session.requestReferenceSpace("local");
    const service = new Panoloc(relative(""), { key: key.value || undefined });
    const tracker = trackSession(session, space, gl, { service, mapId });
    this.listen(tracker);
    const draw: XRFrameRequestCallback = (_, frame) => {
      session.requestAnimationFrame(draw);
      // Browsers show the camera behind what is drawn, and nothing where nothing is.
      gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
      gl.clear(gl.COLOR_BUFFER_BIT);
      this.look(frame.getViewerPose(space), tracker);
    };
    session.requestAnimationFrame(draw);
  }

  /** Begin a note at what the view shows there, a metre away. */
  begin(spot = MIDDLE): void {
    if (!this.now || !this.canLeave) return;
    const { view, sessionFromMap } = this.now;
    this.draft = ownPoint(transform(inverse(sessionFromMap), pointAt(spot, DISTANCE_M, view)));
  }

  leave(text: string): void {
    if (this.draft && this.kept) this.notes = this.kept.add(text, this.draft);
    this.draft = null;
  }

  remove(id: number): void {
    this.notes = this.kept?.remove(id) ?? [];
  }

  private listen(tracker: Tracker): void {
    const found = ({ map_id, map_revision }: Localized): void => {
      this.news = FOUND;
      this.kept = new Notes(localStorage, map_id, map_revision);
      this.notes = this.kept.all();
    };
    tracker.on("located", found);
    tracker.on("corrected", found);
    tracker.on("lost", () => (this.news = LOST));
    tracker.on("answer", (answer) => {
      if (this.isLocated) this.news = FOUND;
      else if (answer.status !== "localized") this.news = `Not found yet. ${adviceOf(answer, "")[0] ?? LOOKING}`;
    });
    tracker.on("error", (error) => (this.news = errorWords(error, key.value !== "")));
  }

  private look(pose: XRViewerPose | undefined, tracker: Tracker): void {
    const view = pose?.emulatedPosition ? undefined : pose?.views[0];
    const { sessionFromMap } = tracker;
    this.isTracked = view !== undefined;
    this.now = view && sessionFromMap ? { view, sessionFromMap } : null;
    this.isLocated = this.now !== null;
    this.canLeave = this.isLocated && !tracker.isDoubted;
    const shown = this.draft ? [...this.notes, { id: 0, text: "New note", position_m: this.draft }] : this.notes;
    this.seen = shown.flatMap((note) => {
      const { x, y, z } = note.position_m;
      const seen = this.now && seenAt(transform(this.now.sessionFromMap, scanPoint(x, y, z)), this.now.view);
      return seen ? [{ ...note, ...seen }] : [];
    });
  }
}
