/** Whether the service is there: asked now and then, so that a page that stays open says when it went and came back. */

import { relative } from "../api/service.ts";
import type { Health } from "../api/types.ts";
import { key } from "../api/key.svelte.ts";
import { poll } from "./polling.ts";

const PAUSE_MS = 3000;

type State = "unknown" | "ready" | "starting" | "gone";

let state = $state<State>("unknown");
let waitingFor = $state<string[]>([]);
let returns = $state(0);

export const connection = {
  get state(): State {
    return state;
  },
  get waitingFor(): string[] {
    return waitingFor;
  },
  /** How often the service has come (back); what depends on it loads anew. */
  get returns(): number {
    return returns;
  },
  watch(): () => void {
    return poll(look, PAUSE_MS);
  },
};

async function look(): Promise<boolean> {
  let next: State;
  try {
    const response = await fetch(relative("/health/ready"), { headers: key.headers(), cache: "no-store" });
    const health = (await response.json()) as Health;
    waitingFor = health.waiting_for ?? [];
    next = health.status === "ready" ? "ready" : "starting";
  } catch {
    next = "gone";
  }
  if (state === "gone" && next !== "gone") returns += 1;
  state = next;
  return true;
}
