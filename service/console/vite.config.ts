import { svelte } from "@sveltejs/vite-plugin-svelte";
import { defineConfig } from "vite";

// Relative paths: the console works behind a proxy that serves it below a prefix.
export default defineConfig({
  base: "./",
  plugins: [svelte()],
  build: {
    outDir: "built", assetsDir: "console", assetsInlineLimit: 0, modulePreload: false, chunkSizeWarningLimit: 1000,
    // Phones load a page of their own, without what draws in 3D.
    rolldownOptions: { input: { index: "index.html", phone: "m/index.html" } },
  },
  server: {
    fs: { allow: [".", "../../clients/js/src"] },
    proxy: Object.fromEntries(["/maps", "/localize", "/localizations", "/batches", "/health", "/metrics", "/demo"].map((path) => [path, "http://127.0.0.1:8000"])),
  },
});
