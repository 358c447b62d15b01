import type { components } from "../../generated/api";
import type { Run } from "../net/api";

export type Kind = NonNullable<components["schemas"]["BoardRequest"]["kind"]>;

/** A board, as far as a person at the table has to know it. */
export interface Board {
  kind: Kind;
  columns: number;
  rows: number;
  pitch_m: number;
}

/** What the service takes for whatever a request does not tell of the board. */
export const USUAL: Board = { kind: "charuco", columns: 9, rows: 7, pitch_m: 0.026 };

export const KINDS: Record<Kind, string> = {
  charuco: "ChArUco: a chessboard with markers",
  checkerboard: "chessboard",
  circles: "dots",
};

const SHORT: Record<Kind, string> = { charuco: "ChArUco", checkerboard: "chessboard", circles: "dots" };

/** A board in words, as `ChArUco, 9 x 7 of 26 mm`; null: it does not tell. */
export function boardWords(told: Board | Run["board"]): string | null {
  if (told === null) return null;
  const { kind, columns, rows, pitch_m } = told;
  const name = Object.entries(SHORT).find(([one]) => one === kind)?.[1];
  if (name === undefined || typeof pitch_m !== "number") return null;
  return `${name}, ${columns} x ${rows} of ${+(pitch_m * 1000).toFixed(3)} mm`;
}

/** How large the views say that the board is, as `100.20 % ± 0.09 % of the size told`; null: they do not. */
export function scaleWords(told: Run["board"]): string | null {
  const { scale, scale_sigma } = told ?? {};
  if (typeof scale !== "number") return null;
  const sure = typeof scale_sigma === "number" ? ` ± ${(scale_sigma * 100).toFixed(2)} %` : "";
  return `${(scale * 100).toFixed(2)} %${sure} of the size told`;
}
