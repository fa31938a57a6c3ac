/** Turning the head where somebody stands: drag, arrow keys; wheel, two fingers and + − for the angle of view. */

import { levelRotation, type Rotation } from "./frames.ts";

const TURN_PER_KEY = Math.PI / 24;
/** Of a key, or a notch of the wheel. */
const ZOOM = 1.15;
const STEEPEST = Math.PI / 2 - 0.01;
const [NARROWEST, WIDEST] = [20, 110];

export class LookAround {
  yaw = 0;
  pitch = 0;
  fovDeg = 75;
  /** A tilted photo's own rotation, until somebody turns. */
  private own: Rotation | null = null;
  /** Where each finger, or the mouse, is. */
  private readonly held = new Map<number, [number, number]>();
  private readonly element: HTMLElement;
  private readonly changed: () => void;
  private isOn = false;

  constructor(element: HTMLElement, changed: () => void) {
    this.element = element;
    this.changed = changed;
    element.addEventListener("pointerdown", this.down);
    element.addEventListener("pointermove", this.move);
    element.addEventListener("pointerup", this.up);
    element.addEventListener("pointercancel", this.up);
    element.addEventListener("wheel", this.wheel, { passive: false });
    element.addEventListener("keydown", this.press);
  }

  get rotation(): Rotation {
    return this.own ?? levelRotation(this.yaw, this.pitch);
  }

  /** Look this way; own: exactly as a camera did, tilt included. */
  begin(yaw: number, pitch: number, own: Rotation | null, fovDeg: number): void {
    [this.yaw, this.pitch, this.own, this.fovDeg, this.isOn] = [yaw, pitch, own, fovDeg, true];
  }

  end(): void {
    this.isOn = false;
    this.held.clear();
  }

  dispose(): void {
    this.element.removeEventListener("pointerdown", this.down);
    this.element.removeEventListener("pointermove", this.move);
    this.element.removeEventListener("pointerup", this.up);
    this.element.removeEventListener("pointercancel", this.up);
    this.element.removeEventListener("wheel", this.wheel);
    this.element.removeEventListener("keydown", this.press);
  }

  private turn(yaw: number, pitch: number): void {
    this.own = null;
    this.yaw += yaw;
    this.pitch = Math.max(-STEEPEST, Math.min(STEEPEST, this.pitch + pitch));
    this.changed();
  }

  private zoom(factor: number): void {
    this.fovDeg = Math.max(NARROWEST, Math.min(WIDEST, this.fovDeg * factor));
    this.changed();
  }

  private readonly down = (event: PointerEvent): void => {
    if (!this.isOn) return;
    this.held.set(event.pointerId, [event.clientX, event.clientY]);
    this.element.setPointerCapture(event.pointerId);
  };

  private readonly move = (event: PointerEvent): void => {
    const last = this.held.get(event.pointerId);
    if (!this.isOn || last === undefined) return;
    const spread = this.spread();
    this.held.set(event.pointerId, [event.clientX, event.clientY]);
    if (this.held.size > 1) {
      if (spread > 0 && this.spread() > 0) this.zoom(spread / this.spread());
      return;
    }
    const perPixel = ((this.fovDeg / 180) * Math.PI) / this.element.clientHeight;
    this.turn((event.clientX - last[0]) * perPixel, (event.clientY - last[1]) * perPixel);
  };

  private readonly up = (event: PointerEvent): void => {
    this.held.delete(event.pointerId);
  };

  /** Pixels between two fingers. */
  private spread(): number {
    const [one, other] = [...this.held.values()];
    return one && other ? Math.hypot(one[0] - other[0], one[1] - other[1]) : 0;
  }

  private readonly wheel = (event: WheelEvent): void => {
    if (!this.isOn) return;
    event.preventDefault();
    this.zoom(event.deltaY > 0 ? ZOOM : 1 / ZOOM);
  };

  private readonly press = (event: KeyboardEvent): void => {
    if (!this.isOn) return;
    const turns: Record<string, [number, number]> = {
      ArrowLeft: [TURN_PER_KEY, 0], ArrowRight: [-TURN_PER_KEY, 0], ArrowUp: [0, TURN_PER_KEY], ArrowDown: [0, -TURN_PER_KEY],
    };
    const turn = turns[event.key];
    if (turn) this.turn(...turn);
    else if (event.key === "+" || event.key === "=") this.zoom(1 / ZOOM);
    else if (event.key === "-") this.zoom(ZOOM);
    else return;
    event.preventDefault();
  };
}
