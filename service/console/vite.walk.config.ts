import { svelte } from "@sveltejs/vite-plugin-svelte";
import { defineConfig } from "vite";

// The page of a walk-through, which exports copy: one script and one style sheet that a browser loads from a folder.
export default defineConfig({
  plugins: [svelte()],
  publicDir: "walk",
  build: {
    outDir: "built/walk", emptyOutDir: true, assetsInlineLimit: 0, modulePreload: false, cssCodeSplit: false,
    rolldownOptions: {
      input: "src/walk/main.ts",
      output: { format: "iife", entryFileNames: "page.js", assetFileNames: "page[extname]" },
    },
  },
});
