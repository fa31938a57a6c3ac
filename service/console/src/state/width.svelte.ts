/** What of a view the window has room for. */

import { drawsWithWebgl } from "../scene/paint/graphics.ts";

const query = window.matchMedia("(max-width: 640px)");

let isNarrow = $state(query.matches);
query.addEventListener("change", () => (isNarrow = query.matches));

export const width = {
  get isNarrow(): boolean {
    return isNarrow;
  },
  /** Whether the plan stands for the 3D view: on phones without a graphics processor. */
  get isFlat(): boolean {
    return isNarrow && !drawsWithWebgl();
  },
};
