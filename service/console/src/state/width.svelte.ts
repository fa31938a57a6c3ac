/** Whether the window is too narrow for 3D: a plan and lists are shown then. */

const query = window.matchMedia("(max-width: 640px)");

let isNarrow = $state(query.matches);
query.addEventListener("change", () => (isNarrow = query.matches));

export const width = {
  get isNarrow(): boolean {
    return isNarrow;
  },
};
