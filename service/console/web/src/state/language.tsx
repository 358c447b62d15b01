import { signal } from "@preact/signals";
import { type ComponentChildren, Fragment } from "preact";
import { LANGUAGES } from "../../generated/languages";
import { chooseLanguage, languageTag } from "../texts/translate";

const STORED = "pointchain.language";

/** The language of the texts, a BCP 47 tag. */
export const language = signal(languageTag());

/** Load the language that a person chose in this browser, or else the first known one of the browser's languages. */
export async function applyLanguage(): Promise<void> {
  const chosen = storedLanguage();
  await chooseLanguage(chosen === null ? navigator.languages : [chosen]);
  language.value = languageTag();
}

/** Change the language of the texts, and remember it in this browser. */
export async function changeLanguage(tag: string): Promise<void> {
  try {
    localStorage.setItem(STORED, tag);
  } catch {
    // The browser stores nothing: the language then holds until the page is loaded again.
  }
  await chooseLanguage([tag]);
  language.value = languageTag();
}

/** Return the stored language; null if there is none with a catalogue, or the browser stores nothing. */
function storedLanguage(): string | null {
  try {
    const tag = localStorage.getItem(STORED);
    return tag !== null && LANGUAGES.includes(tag) ? tag : null;
  } catch {
    return null;
  }
}

/** A part of the page that is drawn again in the new language when the language changes. */
export function InLanguage({ children }: { children: ComponentChildren }) {
  return <Fragment key={language.value}>{children}</Fragment>;
}
