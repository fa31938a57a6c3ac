/** Photos from the folder: scripts that hand their data over, because a page in a folder may not read the pixels of a picture beside it. */

import { decodePhoto } from "../scene/photo.ts";

export type PhotoSize = "medium" | "large";

const MOST_KEPT = 8;
const arrived = new Map<string, string>();
window.panolocPhoto = (name, url) => void arrived.set(name, url);

/** Loads photos, and keeps the last ones in the middle size. mostPixels: across. */
export class PhotoFiles {
  private readonly kept = new Map<number, Promise<HTMLCanvasElement>>();
  private readonly mostPixels: number;

  constructor(mostPixels: number) {
    this.mostPixels = mostPixels;
  }

  medium(number: number): Promise<HTMLCanvasElement> {
    const photo = this.kept.get(number) ?? this.load(number, "medium");
    this.kept.delete(number);
    this.kept.set(number, photo);
    photo.catch(() => this.kept.delete(number));
    if (this.kept.size > MOST_KEPT) this.kept.delete(this.kept.keys().next().value!);
    return photo;
  }

  large(number: number): Promise<HTMLCanvasElement> {
    return this.load(number, "large");
  }

  private async load(number: number, size: PhotoSize): Promise<HTMLCanvasElement> {
    const url = await dataOf(`${number}-${size}`);
    return decodePhoto(await (await fetch(url)).blob(), this.mostPixels);
  }
}

function dataOf(name: string): Promise<string> {
  return new Promise((resolve, reject) => {
    const script = document.createElement("script");
    script.src = `walk/photos/${name}.js`;
    script.onload = () => {
      const url = arrived.get(name);
      arrived.delete(name);
      script.remove();
      if (url) resolve(url);
      else reject(new Error(`walk/photos/${name}.js is damaged; copy the folder again`));
    };
    script.onerror = () => {
      script.remove();
      reject(new Error(`walk/photos/${name}.js is missing; keep the folder together`));
    };
    document.head.append(script);
  });
}
