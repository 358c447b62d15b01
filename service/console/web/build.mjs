// Builds ../built from these sources, with a compressed copy of each file, and prints the sizes.
import { build } from "esbuild";
import { cp, mkdir, readdir, readFile, rm, writeFile } from "node:fs/promises";
import { join } from "node:path";
import { gzipSync } from "node:zlib";
import { generateTextTypes } from "./texts.mjs";

const BUILT = "../built";
const STATIC = ["index.html", "icon.svg"];

await rm(BUILT, { recursive: true, force: true });
await mkdir(BUILT, { recursive: true });
await generateTextTypes();
await build({
  entryPoints: ["src/stop.ts", "src/main.tsx"],
  outdir: BUILT,
  bundle: true,
  splitting: true,
  format: "esm",
  target: "es2022",
  minify: true,
  charset: "utf8",
  chunkNames: "[name]-[hash]",
  jsx: "automatic",
  jsxImportSource: "preact",
  legalComments: "none",
  logLevel: "warning",
});
// The licences require that they are distributed with the built packages.
const { dependencies } = JSON.parse(await readFile("package.json", "utf8"));
const licences = Object.keys(dependencies).map(async (name) => {
  const text = await readFile(join("node_modules", name, "LICENSE"), "utf8");
  return `${name}\n\n${text}`;
});
await writeFile(join(BUILT, "licences.txt"), (await Promise.all(licences)).join("\n---\n\n"));
await Promise.all(STATIC.map((name) => cp(name, join(BUILT, name))));

for (const name of (await readdir(BUILT)).sort()) {
  const content = await readFile(join(BUILT, name));
  const compressed = gzipSync(content, { level: 9 });
  await writeFile(join(BUILT, `${name}.gz`), compressed);
  const kB = (bytes) => (bytes / 1000).toFixed(1).padStart(7);
  console.log(`${kB(content.length)} kB ${kB(compressed.length)} kB gzipped  ${name}`);
}
