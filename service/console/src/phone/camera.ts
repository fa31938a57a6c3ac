/** The rear camera of the phone, and pictures of it. */

export interface Shot {
  image: Blob;
  width: number;
  height: number;
  /** What its field of view is remembered by. */
  lens: string;
}

/** Finer pictures take longer to send, and are found no better. */
const LONGER_SIDE_PX = 1280;
const QUALITY = 0.88;

/** Open the camera. Rejects with a DOMException, whose name says why. */
export function openCamera(): Promise<MediaStream> {
  // `resizeMode`, where a browser knows it: cropped pictures have another field of view.
  const video = { facingMode: { ideal: "environment" }, width: { ideal: 1920 }, height: { ideal: 1080 }, resizeMode: { ideal: "none" } };
  return navigator.mediaDevices.getUserMedia({ audio: false, video: video as MediaTrackConstraints });
}

/** Return what the camera shows now. */
export async function takeShot(video: HTMLVideoElement): Promise<Shot> {
  const scale = Math.min(1, LONGER_SIDE_PX / Math.max(video.videoWidth, video.videoHeight));
  const canvas = document.createElement("canvas");
  canvas.width = Math.round(video.videoWidth * scale);
  canvas.height = Math.round(video.videoHeight * scale);
  canvas.getContext("2d")!.drawImage(video, 0, 0, canvas.width, canvas.height);
  const image = await new Promise<Blob | null>((resolve) => canvas.toBlob(resolve, "image/jpeg", QUALITY));
  if (image === null) throw new Error("The browser could not store the picture.");
  const label = (video.srcObject as MediaStream).getVideoTracks()[0]?.label ?? "";
  return { image, width: canvas.width, height: canvas.height, lens: lensName(label, video.videoWidth, video.videoHeight) };
}

/** Return a picture that somebody chose, unchanged: it may say itself what its camera is. */
export async function shotOf(file: File): Promise<Shot> {
  const { width, height } = await createImageBitmap(file);
  return { image: file, width, height, lens: lensName("file", width, height) };
}

/** Return why the camera is not open, and what to do. */
export function cameraWords(error: unknown): string {
  const name = error instanceof DOMException ? error.name : "";
  if (name === "NotAllowedError") return "The browser may not use the camera. Allow it in the settings of this page and try again, or use the camera app.";
  if (name === "NotFoundError") return "This device has no camera that the browser can use. Choose a photo instead.";
  if (name === "NotReadableError") return "Another app uses the camera. Close it and try again.";
  return "The camera cannot be opened. Try again, or use the camera app.";
}

function lensName(label: string, width: number, height: number): string {
  return `${label} ${Math.max(width, height)}x${Math.min(width, height)}`;
}
