// Writes generated/texts.d.ts: the keys of the English catalogue, with the placeholders and tags of each text.
// Writes generated/languages.ts: the languages that have a catalogue.
import { mkdir, readdir, readFile, writeFile } from "node:fs/promises";
import { pathToFileURL } from "node:url";

const PLURAL_FORMS = new Set(["zero", "one", "two", "few", "many", "other"]);

/** Return whether a node of a catalogue is one text in several plural forms. */
export function isPlural(node) {
  return "other" in node && Object.keys(node).every((name) => PLURAL_FORMS.has(name));
}

/** List [key, texts] of a catalogue; a plural text has several forms. */
export function entriesOf(node, prefix = "") {
  return Object.entries(node).flatMap(([name, value]) => {
    const key = prefix + name;
    if (typeof value === "string") return [[key, [value]]];
    return isPlural(value) ? [[key, Object.values(value)]] : entriesOf(value, `${key}.`);
  });
}

/** Return the names that a pattern finds in some texts, each once. */
export function namesIn(texts, pattern) {
  return [...new Set(texts.flatMap((text) => [...text.matchAll(pattern)].map(([, name]) => name)))];
}

export const PLACEHOLDER = /\{(\w+)\}/g;
export const TAG = /<(\w+)>/g;

function declarationsOf(catalogue) {
  const union = (names) => names.map((name) => JSON.stringify(name)).join(" | ") || "never";
  const lines = (pattern, keepEmpty) =>
    entriesOf(catalogue)
      .map(([key, texts]) => [key, namesIn(texts, pattern)])
      .filter(([, names]) => keepEmpty || names.length > 0)
      .map(([key, names]) => `  ${JSON.stringify(key)}: ${union(names)};`);
  return [
    "// Generated from src/texts/en.json by texts.mjs. Do not edit.",
    "export interface Placeholders {",
    ...lines(PLACEHOLDER, true),
    "}",
    "export interface Tags {",
    ...lines(TAG, false),
    "}",
    "",
  ].join("\n");
}

/** Write the declarations and the list of languages. */
export async function generateTextTypes() {
  const catalogue = JSON.parse(await readFile("src/texts/en.json", "utf8"));
  await mkdir("generated", { recursive: true });
  await writeFile("generated/texts.d.ts", declarationsOf(catalogue));
  const files = (await readdir("src/texts")).filter((name) => name.endsWith(".json"));
  const languages = JSON.stringify(files.map((name) => name.replace(".json", "")).sort());
  const note = "// Generated from the files src/texts/*.json by texts.mjs. Do not edit.";
  await writeFile("generated/languages.ts", `${note}\nexport const LANGUAGES: readonly string[] = ${languages};\n`);
}

if (import.meta.url === pathToFileURL(process.argv[1]).href) await generateTextTypes();
