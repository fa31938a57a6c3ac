/** Requests that the service put off (429, 503 with `Retry-After`): sent again when it says so, and said to wait meanwhile. */

/** Longer than the service ever asks for; a proxy may ask for hours. */
const LONGEST_S = 30;
const MOST_TRIES = 20;

let waiting = $state<{ until: number; seconds: number }[]>([]);

export const patience = {
  /** Seconds that the longest of the waiting requests was asked to wait, 0 where none waits. */
  get seconds(): number {
    return Math.max(0, ...waiting.map((each) => each.seconds));
  },
};

/** Return the seconds after which to send a request again, null where it was not put off, or too often. */
export function putOff(status: number, retryAfter: string | null, numTries: number): number | null {
  if ((status !== 429 && status !== 503) || retryAfter === null || numTries >= MOST_TRIES) return null;
  const seconds = Number(retryAfter);
  return Number.isFinite(seconds) ? Math.min(LONGEST_S, Math.max(1, seconds)) : null;
}

/** Wait so many seconds; ends early, with an AbortError, once the signal says so. */
export async function wait(seconds: number, signal?: AbortSignal | null): Promise<void> {
  const entry = { until: Date.now() + 1000 * seconds, seconds: Math.ceil(seconds) };
  waiting = [...waiting, entry];
  try {
    await new Promise<void>((resolve, reject) => {
      const giveUp = (): void => reject(new DOMException("The request was given up.", "AbortError"));
      if (signal?.aborted) giveUp();
      signal?.addEventListener("abort", giveUp);
      setTimeout(resolve, 1000 * seconds);
    });
  } finally {
    waiting = waiting.filter((each) => each.until !== entry.until);
  }
}
