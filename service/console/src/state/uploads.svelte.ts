/** Scans on their way to the service. */

import { shown } from "../api/problem.ts";
import type { Place, Problem } from "../api/types.ts";
import { type Upload, upload } from "../api/upload.ts";
import { maps } from "./maps.svelte.ts";

export interface ScanOptions {
  name?: string;
  tags?: string[];
  unit?: string;
  up_axis?: string;
}

export class ScanUpload {
  readonly name: string;
  readonly numBytes: number;
  share = $state(0);
  problem = $state<Problem | null>(null);
  private readonly scan: File;
  private readonly options: ScanOptions;
  private sending: Upload<Place> | null = null;

  constructor(scan: File, options: ScanOptions) {
    this.scan = scan;
    this.options = options;
    this.name = options.name ?? scan.name;
    this.numBytes = scan.size;
  }

  /** Send the scan; return the map, null where that failed or was cancelled. */
  async send(): Promise<Place | null> {
    this.problem = null;
    this.share = 0;
    const form = new FormData();
    form.append("options", JSON.stringify(this.options));
    form.append("file", this.scan, this.scan.name);
    this.sending = upload<Place>({ path: "/maps", form, onProgress: (share) => (this.share = share) });
    try {
      const place = await this.sending.done;
      maps.put(place);
      uploads.remove(this);
      return place;
    } catch (error) {
      if (error instanceof DOMException) uploads.remove(this);
      else this.problem = shown(error);
      return null;
    }
  }

  cancel(): void {
    if (this.problem) uploads.remove(this);
    else this.sending?.cancel();
  }
}

let items = $state<ScanUpload[]>([]);

export const uploads = {
  get items(): ScanUpload[] {
    return items;
  },
  begin(scan: File, options: ScanOptions): Promise<Place | null> {
    const each = new ScanUpload(scan, options);
    items = [each, ...items];
    return each.send();
  },
  remove(gone: ScanUpload): void {
    items = items.filter((each) => each !== gone);
  },
};
