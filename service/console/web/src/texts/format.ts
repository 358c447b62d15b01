import { t } from "./translate";

/** Return metres in millimetres, for people. */
export function mm(metres: number, digits = 1): string {
  return t("units.mm", { value: (metres * 1000).toFixed(digits) });
}

/** Return radians in degrees, for people. */
export function degrees(radians: number, digits = 0): string {
  return t("units.degrees", { value: ((radians * 180) / Math.PI).toFixed(digits) });
}

/** Return the coordinates of a point of the base frame, for people. */
export function pointText(point: readonly number[]): string {
  const [x = "", y = "", z = ""] = point.map((metres) => (metres * 1000).toFixed(1));
  return t("units.point", { x, y, z });
}

/** Return a share of one in percent, for people. */
export function percent(share: number, digits = 0): string {
  return t("units.percent", { value: digits === 0 ? Math.round(share * 100) : (share * 100).toFixed(digits) });
}

/** Return a standard deviation, for people. */
export function plusMinus(metres: number): string {
  return t("units.plus_minus", { value: mm(metres, 2) });
}

/** Return the time of day. */
export function clock(moment: Date): string {
  return moment.toLocaleTimeString(undefined, { hour: "2-digit", minute: "2-digit", second: "2-digit" });
}

/** Return date and time of day; `medium` includes the seconds. */
export function when(rfc3339: string, timeStyle: "short" | "medium" = "short"): string {
  return new Date(rfc3339).toLocaleString(undefined, { dateStyle: "medium", timeStyle });
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
