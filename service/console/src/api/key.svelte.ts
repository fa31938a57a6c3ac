/** The API key, for services that ask for one: kept for this tab alone, and forgotten with it. */

const ENTRY = "panoloc-key";

let current = $state(sessionStorage.getItem(ENTRY) ?? "");
let wanted = $state(false);
let refused = $state(false);

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
  /** Whether somebody asked for the field of the key. */
  get wanted(): boolean {
    return wanted;
  },
  /** Whether the service refused a request for want of a key: then there is nothing to show but the field. */
  get refused(): boolean {
    return refused;
  },
  refuse(): void {
    refused = true;
  },
  ask(): void {
    wanted = true;
  },
  headers(): Record<string, string> {
    return current ? { Authorization: `Bearer ${current}` } : {};
  },
};
