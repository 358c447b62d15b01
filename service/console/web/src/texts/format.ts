import { languageTag, t } from "./translate";

const NUMBERS = new Map<string, Intl.NumberFormat>();

/** Return a number with this many decimals, and the decimal sign of the language of the texts. */
export function decimal(value: number, digits: number): string {
  const tag = languageTag();
  const key = `${tag}/${digits}`;
  let format = NUMBERS.get(key);
  if (format === undefined) {
    const fixed = { minimumFractionDigits: digits, maximumFractionDigits: digits };
    format = new Intl.NumberFormat(tag, { useGrouping: false, ...fixed });
    NUMBERS.set(key, format);
  }
  return format.format(value);
}

/** Return the locale of dates: the language of the texts, with the region of the browser. */
function dateLocale(): string {
  const tag = languageTag();
  const sameLanguage = navigator.languages.find((one) => one.replace(/-.*/, "") === tag);
  const region = navigator.languages.map((one) => new Intl.Locale(one).region).find((one) => one !== undefined);
  return sameLanguage ?? (region === undefined ? tag : `${tag}-${region}`);
}

/** Return metres in millimetres, for people. */
export function mm(metres: number, digits = 1): string {
  return t("units.mm", { value: decimal(metres * 1000, digits) });
}

/** Return radians in degrees, for people. */
export function degrees(radians: number, digits = 0): string {
  return t("units.degrees", { value: decimal((radians * 180) / Math.PI, digits) });
}

/** Return the coordinates of a point of the base frame, for people. */
export function pointText(point: readonly number[]): string {
  const [x = "", y = "", z = ""] = point.map((metres) => decimal(metres * 1000, 1));
  return t("units.point", { x, y, z });
}

/** Return a share of one in percent, for people. */
export function percent(share: number, digits = 0): string {
  return t("units.percent", { value: decimal(share * 100, digits) });
}

/** Return a standard deviation, for people. */
export function plusMinus(metres: number): string {
  return t("units.plus_minus", { value: mm(metres, 2) });
}

/** Return the time of day. */
export function clock(moment: Date): string {
  return moment.toLocaleTimeString(dateLocale(), { hour: "2-digit", minute: "2-digit", second: "2-digit" });
}

/** Return date and time of day; `medium` includes the seconds. */
export function when(rfc3339: string, timeStyle: "short" | "medium" = "short"): string {
  return new Date(rfc3339).toLocaleString(dateLocale(), { dateStyle: "medium", timeStyle });
}

const UNITS = [
  [86400, "day"],
  [3600, "hour"],
  [60, "minute"],
  [1, "second"],
] as const;

/** Return a duration in its largest unit, such as `3 days`. */
export function span(seconds: number): string {
  for (const [unit_s, unit] of UNITS) {
    const count = Math.floor(seconds / unit_s);
    if (count >= 1) return t(`units.${unit}`, { count });
  }
  return t("units.moment");
}
