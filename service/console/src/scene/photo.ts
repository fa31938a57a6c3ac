/** Decodes a photo for the 3D view, smaller where it is very large. */

/** Pixels across: more than most screens show of a panorama at once, and within what every WebGL 2 takes. */
const MOST_PIXELS = 4096;

export async function decodePhoto(photo: Blob, mostPixels = MOST_PIXELS): Promise<HTMLCanvasElement> {
  const bitmap = await createImageBitmap(photo).catch(() => {
    throw new Error("This browser cannot show the photo: most browsers cannot show HEIC. The answer is not affected.");
  });
  const scale = Math.min(1, mostPixels / Math.max(bitmap.width, bitmap.height));
  const canvas = document.createElement("canvas");
  canvas.width = Math.max(1, Math.round(bitmap.width * scale));
  canvas.height = Math.max(1, Math.round(bitmap.height * scale));
  canvas.getContext("2d", { willReadFrequently: true })!.drawImage(bitmap, 0, 0, canvas.width, canvas.height);
  bitmap.close();
  return canvas;
}
