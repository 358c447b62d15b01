import { LANGUAGES } from "../../generated/languages";
import { changeLanguage, language } from "../state/language";
import { t } from "../texts/translate";

/** A list of the languages of the console, each by its own name. */
export function LanguageChoice() {
  return (
    <select
      class="language"
      aria-label={t("app.language")}
      value={language.value}
      onChange={(event) => void changeLanguage(event.currentTarget.value)}
    >
      {LANGUAGES.map((tag) => (
        <option key={tag} value={tag} lang={tag}>
          {new Intl.DisplayNames([tag], { type: "language" }).of(tag)}
        </option>
      ))}
    </select>
  );
}
