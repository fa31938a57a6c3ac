/** What an export tells the page: `walk_document` of `core/exports/walk.py` writes it as a script, because a page in a folder may fetch no file. */

import type { CameraOfImage, Vector3 } from "../api/types.ts";
import type { Rotation } from "../scene/frames.ts";

export interface WalkPhoto {
  name: string;
  /** Its day, as 2026-03-12. */
  taken: string | null;
  /** Metres, z up. */
  position: Vector3;
  /** From camera (x forward, y left, z up) to map. */
  rotation: Rotation;
  model: CameraOfImage["model"];
  hfovDeg: number;
  hasLarge: boolean;
  floor: number;
  /** Photos that are seen from it, by number, the nearest first. */
  links: number[];
}

/** A floor and its picture from above. left, top: of the upper left corner, metres; x to the right, y up. */
export interface WalkFloor {
  level: number;
  plan: string;
  left: number;
  top: number;
  width: number;
  height: number;
}

export interface WalkData {
  title: string;
  /** Of positions and floors, in the map's own frame, metres. */
  origin: Vector3;
  floors: WalkFloor[];
  photos: WalkPhoto[];
}

declare global {
  interface Window {
    panolocWalk?: WalkData;
    panolocPhoto?: (name: string, url: string) => void;
  }
}

export function walkData(): WalkData {
  const data = window.panolocWalk;
  if (!data) throw new Error("expected the file walk/data.js beside this page; keep the folder together");
  return data;
}

export function dayWords(taken: string): string {
  return new Date(`${taken}T00:00:00Z`).toLocaleDateString("en-GB", { day: "numeric", month: "long", year: "numeric", timeZone: "UTC" });
}
