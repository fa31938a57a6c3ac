/** Retries of requests that were answered with 429 or 503 and `Retry-After`. */

/** Longer than the service ever asks for; a proxy may ask for hours. */
const LONGEST_S = 30;
const MOST_TRIES = 20;

let waiting = $state<{ until: number; seconds: number }[]>([]);

export const retries = {
  /** Longest pause of the waiting requests in seconds, 0 if none waits. */
  get seconds(): number {
    return Math.max(0, ...waiting.map((each) => each.seconds));
  },
};

/** Return the seconds until a retry, null for no retry: another status, or too many tries. */
export function retryPause(status: number, retryAfter: string | null, numTries: number): number | null {
  if ((status !== 429 && status !== 503) || retryAfter === null || numTries >= MOST_TRIES) return null;
  const seconds = Number(retryAfter);
  return Number.isFinite(seconds) ? Math.min(LONGEST_S, Math.max(1, seconds)) : null;
}

/** Wait; throws an AbortError as soon as the signal aborts. */
export async function wait(seconds: number, signal?: AbortSignal | null): Promise<void> {
  const entry = { until: Date.now() + 1000 * seconds, seconds: Math.ceil(seconds) };
  waiting = [...waiting, entry];
  try {
    await new Promise<void>((resolve, reject) => {
      const giveUp = (): void => reject(new DOMException("The request was cancelled.", "AbortError"));
      if (signal?.aborted) giveUp();
      signal?.addEventListener("abort", giveUp);
      setTimeout(resolve, 1000 * seconds);
    });
  } finally {
    waiting = waiting.filter((each) => each.until !== entry.until);
  }
}
