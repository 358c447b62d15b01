// Makes ../built of these sources, and says what it weighs.
import { build } from "esbuild";
import { cp, mkdir, readdir, readFile, rm } from "node:fs/promises";
import { join } from "node:path";
import { gzipSync } from "node:zlib";

const BUILT = "../built";
const STATIC = ["index.html", "icon.svg"];

await rm(BUILT, { recursive: true, force: true });
await mkdir(BUILT, { recursive: true });
await build({
  entryPoints: ["src/stop.ts", "src/main.tsx"],
  outdir: BUILT,
  bundle: true,
  splitting: true,
  format: "esm",
  target: "es2022",
  minify: true,
  chunkNames: "[name]-[hash]",
  jsx: "automatic",
  jsxImportSource: "preact",
  legalComments: "linked",
  logLevel: "warning",
});
await Promise.all(STATIC.map((name) => cp(name, join(BUILT, name))));

for (const name of (await readdir(BUILT)).sort()) {
  const content = await readFile(join(BUILT, name));
  const kB = (bytes) => (bytes / 1000).toFixed(1).padStart(7);
  console.log(`${kB(content.length)} kB ${kB(gzipSync(content).length)} kB gzipped  ${name}`);
}
