/** Clicks and touches that are no drags; Enter clicks into the middle of the view. */

const STILL_PX = 5;

export class Clicks {
  private pressed: [number, number] | null = null;
  private readonly canvas: HTMLCanvasElement;
  private readonly clicked: (at: [number, number], isByKey: boolean) => void;

  /** clicked: called with a point of the view, -1..1 both ways, y upwards. */
  constructor(canvas: HTMLCanvasElement, clicked: (at: [number, number], isByKey: boolean) => void) {
    [this.canvas, this.clicked] = [canvas, clicked];
    canvas.addEventListener("pointerdown", this.down);
    canvas.addEventListener("pointerup", this.up);
    canvas.addEventListener("keydown", this.press);
  }

  dispose(): void {
    this.canvas.removeEventListener("pointerdown", this.down);
    this.canvas.removeEventListener("pointerup", this.up);
    this.canvas.removeEventListener("keydown", this.press);
  }

  private readonly down = (event: PointerEvent): void => {
    // A second finger makes it a pinch.
    this.pressed = event.isPrimary && event.button === 0 ? [event.clientX, event.clientY] : null;
  };

  private readonly up = (event: PointerEvent): void => {
    if (this.pressed === null) return;
    const box = this.canvas.getBoundingClientRect();
    const wasClick = Math.hypot(event.clientX - this.pressed[0], event.clientY - this.pressed[1]) < STILL_PX;
    this.pressed = null;
    if (wasClick) this.clicked([((event.clientX - box.left) / box.width) * 2 - 1, 1 - ((event.clientY - box.top) / box.height) * 2], false);
  };

  private readonly press = (event: KeyboardEvent): void => {
    if (event.key !== "Enter") return;
    event.preventDefault();
    this.clicked([0, 0], true);
  };
}
