/** Notes that somebody left in a room. This browser keeps them, and sends them nowhere. */

import type { Vector } from "../../../../../clients/js/src/index.ts";

export interface Note {
  id: number;
  text: string;
  /** In the map's own frame, z up. */
  position_m: Vector;
}

/** The notes of one revision of a map: the next one may have another frame. */
export class Notes {
  private readonly store: Storage;
  private readonly entry: string;

  constructor(store: Storage, mapId: string, revision: number) {
    this.store = store;
    this.entry = `panoloc-notes ${mapId} ${revision}`;
  }

  all(): Note[] {
    return JSON.parse(this.store.getItem(this.entry) ?? "[]") as Note[];
  }

  /** Return all notes, with a new one. Throws a DOMException where the browser has no room for it. */
  add(text: string, position_m: Vector): Note[] {
    const notes = this.all();
    return this.keep([...notes, { id: Math.max(0, ...notes.map(({ id }) => id)) + 1, text, position_m }]);
  }

  /** Return the notes that are left. */
  remove(id: number): Note[] {
    return this.keep(this.all().filter((note) => note.id !== id));
  }

  private keep(notes: Note[]): Note[] {
    if (notes.length) this.store.setItem(this.entry, JSON.stringify(notes));
    else this.store.removeItem(this.entry);
    return notes;
  }
}
