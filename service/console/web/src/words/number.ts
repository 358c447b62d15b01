/** What a number may be, in the unit that it is written in. */
export interface Limits {
  min: number;
  max: number;
  unit?: string;
  whole?: boolean;
}

/** What somebody has written: the number, null for nothing written or nothing sensible, and what is wrong with it. */
export interface Reading {
  text: string;
  value: number | null;
  fault: string | null;
}

const WRITTEN = /^\d*[.,]?\d+$/;

/** A number as people write it, with a point or a comma. */
export function readNumber(text: string, { min, max, unit = "", whole = false }: Limits): Reading {
  const written = text.trim();
  if (written === "") return { text, value: null, fault: null };
  const value = Number(written.replace(",", "."));
  const isOne = WRITTEN.test(written) && (!whole || Number.isInteger(value));
  if (isOne && value >= min && value <= max) return { text, value, fault: null };
  const range = Number.isFinite(max) ? ` from ${min} to ${max} ${unit}`.trimEnd() : "";
  return { text, value: null, fault: `A ${whole ? "whole " : ""}number${range} is needed` };
}
