/** Metres in millimetres, for people. */
export function mm(metres: number, digits = 1): string {
  return `${(metres * 1000).toFixed(digits)} mm`;
}

/** Radians in degrees, for people. */
export function degrees(radians: number, digits = 0): string {
  return `${((radians * 180) / Math.PI).toFixed(digits)}°`;
}

/** A point of the base frame. */
export function place(point: readonly number[]): string {
  return `(${point.map((metres) => (metres * 1000).toFixed(1)).join(", ")}) mm`;
}

/** A share of one. */
export function percent(share: number): string {
  return `${Math.round(share * 100)} %`;
}

/** The time of day. */
export function clock(moment: Date): string {
  return moment.toLocaleTimeString(undefined, { hour: "2-digit", minute: "2-digit", second: "2-digit" });
}

/** Date and time of day; `medium` has its seconds. */
export function when(rfc3339: string, timeStyle: "short" | "medium" = "short"): string {
  return new Date(rfc3339).toLocaleString(undefined, { dateStyle: "medium", timeStyle });
}

const STEPS: [number, string][] = [
  [86400, "day"],
  [3600, "hour"],
  [60, "minute"],
  [1, "second"],
];

/** How long, in its largest unit: `3 days`. */
export function span(seconds: number): string {
  for (const [unit_s, word] of STEPS) {
    const count = Math.floor(seconds / unit_s);
    if (count >= 1) return `${count} ${word}${count === 1 ? "" : "s"}`;
  }
  return "less than a second";
}

/** So many of a thing: `1 string`, `2 strings`. */
export function counted(count: number, word: string): string {
  return `${count} ${word}${count === 1 ? "" : "s"}`;
}
