/** Light or dark: as the system has it, until the reader turns it. */

type Theme = "light" | "dark";

const ENTRY = "panoloc-theme";
const dark = window.matchMedia("(prefers-color-scheme: dark)");

let chosen = $state<Theme | null>((localStorage.getItem(ENTRY) as Theme | null) ?? null);
let system = $state<Theme>(dark.matches ? "dark" : "light");

function apply(): void {
  if (chosen) document.documentElement.dataset["theme"] = chosen;
}
dark.addEventListener("change", () => (system = dark.matches ? "dark" : "light"));
apply();

export const theme = {
  get current(): Theme {
    return chosen ?? system;
  },
  get other(): Theme {
    return this.current === "dark" ? "light" : "dark";
  },
  turn(): void {
    chosen = this.other;
    localStorage.setItem(ENTRY, chosen);
    apply();
  },
};
