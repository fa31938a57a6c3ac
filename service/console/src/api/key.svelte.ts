/** The API key, for services that ask for one: kept for this tab alone, and forgotten with it. */

const ENTRY = "panoloc-key";

let current = $state(sessionStorage.getItem(ENTRY) ?? "");
let wanted = $state(false);

export const key = {
  get value(): string {
    return current;
  },
  set value(given: string) {
    current = given.trim();
    wanted = false;
    if (current) sessionStorage.setItem(ENTRY, current);
    else sessionStorage.removeItem(ENTRY);
  },
  /** Whether the service refused a request for want of a key. */
  get wanted(): boolean {
    return wanted;
  },
  ask(): void {
    wanted = true;
  },
  headers(): Record<string, string> {
    return current ? { Authorization: `Bearer ${current}` } : {};
  },
};
