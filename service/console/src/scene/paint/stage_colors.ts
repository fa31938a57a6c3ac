import type { StageColors } from "./painter.ts";

/** Of the 3D view, which cannot read style sheets; `--stage`, `--accent` and `--warn` of theme.css. */
export const STAGE_COLORS: Record<"light" | "dark", StageColors> = {
  light: { background: "#e7e9ec", accent: "#2b57d9", unsure: "#b06d00", start: "#0f766e", rim: "#ffffff" },
  dark: { background: "#0b0d10", accent: "#8aa9ff", unsure: "#e6b45c", start: "#5fd4c4", rim: "#10131a" },
};
