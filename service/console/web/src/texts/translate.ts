/**
 * The texts of the console, by key. `en.json` is the complete catalogue. Another language is a file beside it, such as
 * `de.json` with the same keys. A key that it lacks is shown in English.
 */
import type { ComponentChildren } from "preact";
import type { Placeholders, Tags } from "../../generated/texts";
import english from "./en.json";

interface Catalogue {
  readonly [name: string]: string | Catalogue;
}

interface Language {
  tag: string;
  catalogue: Catalogue;
  plural: Intl.PluralRules;
  number: Intl.NumberFormat;
}

type Value = string | number;
type Key = keyof Placeholders;
/** A text without tags. */
export type PlainKey = Exclude<Key, keyof Tags>;
/** `count` chooses the plural form. */
type Values<Name extends string, Other> = { [N in Name]: N extends "count" ? number : Other };
type Arguments<K extends Key> = [Placeholders[K]] extends [never] ? [] : [values: Values<Placeholders[K], Value>];
type TagOf<K extends Key> = K extends keyof Tags ? Tags[K] : never;
type Wrap = (content: ComponentChildren) => ComponentChildren;
type RichValues<K extends Key> = Values<Placeholders[K], ComponentChildren> & { [N in TagOf<K>]: Wrap };

const ENGLISH = languageOf("en", english as Catalogue);
const PLACEHOLDER = /\{(\w+)\}/g;
const TAG = /^<(\w+)>(.*)<\/\1>$/;

let languages: readonly Language[] = [ENGLISH];

function languageOf(tag: string, catalogue: Catalogue): Language {
  const number = new Intl.NumberFormat(tag, { useGrouping: false, maximumFractionDigits: 20 });
  return { tag, catalogue, plural: new Intl.PluralRules(tag), number };
}

function chosen(): Language {
  return languages[0] ?? ENGLISH;
}

/** Return the language of the texts, a BCP 47 tag. */
export function languageTag(): string {
  return chosen().tag;
}

/** Load the first of the preferred languages that has a catalogue. Name it in the page, and fill in the static texts. */
export async function chooseLanguage(preferred: readonly string[]): Promise<void> {
  const language = await firstLanguage(preferred);
  languages = language.tag === ENGLISH.tag ? [ENGLISH] : [language, ENGLISH];
  document.documentElement.lang = language.tag;
  for (const element of document.querySelectorAll<HTMLElement>("[data-text], [data-title]")) {
    const { text, title } = element.dataset;
    if (text !== undefined) element.textContent = findText(text) ?? element.textContent;
    if (title !== undefined) element.title = findText(title) ?? element.title;
  }
}

async function firstLanguage(preferred: readonly string[]): Promise<Language> {
  const tags = preferred.flatMap((tag) => [tag, tag.replace(/-.*/, "")]);
  for (const tag of tags) {
    if (tag === ENGLISH.tag) break;
    try {
      // The build replaces this by a table of the files that exist; for any other name it rejects.
      const { default: catalogue } = (await import(`./${tag}.json`)) as { default: Catalogue };
      return languageOf(tag, catalogue);
    } catch {
      // No such file.
    }
  }
  return ENGLISH;
}

/** Return a text whose key comes from the service, such as a problem's; undefined if no catalogue has it. */
export function findText(key: string, count?: number): string | undefined {
  for (const { catalogue, plural } of languages) {
    const names = key.split(".");
    let found: string | Catalogue | undefined = catalogue;
    for (const name of names) found = typeof found === "object" ? found[name] : undefined;
    if (typeof found === "object" && count !== undefined) found = found[plural.select(count)] ?? found.other;
    if (typeof found === "string") return found;
  }
  return undefined;
}

/** Return a text whose key and values come from the service; undefined if no catalogue has it, or a value is missing. */
export function fillText(key: string, values: Readonly<Record<string, Value>>): string | undefined {
  const text = findText(key);
  const names = [...(text ?? "").matchAll(PLACEHOLDER)].map(([, name = ""]) => name);
  return text !== undefined && names.every((name) => name in values) ? filled(text, values) : undefined;
}

/** Return a text, with its placeholders replaced. */
export function t<K extends PlainKey>(key: K, ...[values]: Arguments<K>): string {
  const given = (values ?? {}) as Record<string, Value>;
  return filled(template(key, given.count), given);
}

/** Return a text with its placeholders replaced. A placeholder without a value stays. */
function filled(text: string, values: Readonly<Record<string, Value>>): string {
  return text.replace(PLACEHOLDER, (whole, name: string) => shown(values[name] ?? whole));
}

/** Return a value as a person reads it: a number has the decimal sign of the language. */
export function shown(value: Value): string {
  return typeof value === "number" ? chosen().number.format(value) : value;
}

/** Return a text as elements: a placeholder may be an element, and a function draws the content of each tag. */
export function rich<K extends Key>(key: K, values: RichValues<K>): ComponentChildren {
  const given = values as Record<string, ComponentChildren | Wrap>;
  return fill(template(key, given.count), given);
}

function template(key: string, count: unknown): string {
  return findText(key, typeof count === "number" ? count : undefined) ?? key;
}

function fill(text: string, values: Record<string, ComponentChildren | Wrap>): ComponentChildren[] {
  return text.split(/(\{\w+\}|<\w+>.*?<\/\w+>)/).map((part): ComponentChildren => {
    const [, tag = "", content = ""] = TAG.exec(part) ?? [];
    const wrap = values[tag];
    if (typeof wrap === "function") return (wrap as Wrap)(fill(content, values));
    if (!part.startsWith("{")) return part;
    const value = values[part.slice(1, -1)] as ComponentChildren;
    return typeof value === "number" ? shown(value) : value;
  });
}
