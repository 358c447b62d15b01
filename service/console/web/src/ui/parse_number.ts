import { t } from "../texts/translate";

/** The range of a number, in the unit in which it is entered. */
export interface Limits {
  min: number;
  max: number;
  unit?: string;
  whole?: boolean;
}

/** An entered number: `value` is null if nothing or no valid number was entered, `fault` says what is wrong. */
export interface ParsedNumber {
  text: string;
  value: number | null;
  fault: string | null;
}

const NUMBER = /^\d*[.,]?\d+$/;

/** Parse a number as people write it, with a point or a comma. */
export function parseNumber(text: string, limits: Limits): ParsedNumber {
  const entered = text.trim();
  if (entered === "") return { text, value: null, fault: null };
  const value = Number(entered.replace(",", "."));
  const valid = NUMBER.test(entered) && (!limits.whole || Number.isInteger(value));
  if (valid && value >= limits.min && value <= limits.max) return { text, value, fault: null };
  return { text, value: null, fault: faultText(limits) };
}

function faultText({ min, max, unit = "", whole = false }: Limits): string {
  if (!Number.isFinite(max)) return whole ? t("field.whole_needed") : t("field.number_needed");
  return whole ? t("field.whole_range", { min, max }) : t("field.number_range", { min, max, unit }).trimEnd();
}
