import type { components } from "../../generated/api";
import type { Run } from "../net/api";
import { percent } from "../texts/format";
import { t } from "../texts/translate";

export type Kind = NonNullable<components["schemas"]["BoardRequest"]["kind"]>;

/** A calibration board, as far as an operator must know it. */
export interface Board {
  kind: Kind;
  columns: number;
  rows: number;
  pitch_m: number;
}

/** The board that the service assumes where a request names none. */
export const DEFAULT_BOARD: Board = { kind: "charuco", columns: 9, rows: 7, pitch_m: 0.026 };

export const KINDS: readonly Kind[] = ["charuco", "checkerboard", "circles"];

/** Describe a board, such as `ChArUco, 9 x 7 of 26 mm`; null: it is unknown. */
export function boardText(board: Board | Run["board"]): string | null {
  if (board === null) return null;
  const { columns, rows, pitch_m } = board;
  const kind = KINDS.find((one) => one === board.kind);
  if (kind === undefined || typeof pitch_m !== "number") return null;
  const pitch = +(pitch_m * 1000).toFixed(3);
  const name = t(`calibration.board.kind.${kind}`);
  return t("calibration.board.description", { kind: name, columns: String(columns), rows: String(rows), pitch });
}

/** Describe the measured size of a board, such as `100.20 % ± 0.09 % of the nominal size`; null: it is unknown. */
export function scaleText(board: Run["board"]): string | null {
  const { scale, scale_sigma } = board ?? {};
  if (typeof scale !== "number") return null;
  if (typeof scale_sigma !== "number") return t("calibration.board.scale", { scale: percent(scale, 2) });
  return t("calibration.board.scale_sigma", { scale: percent(scale, 2), sigma: percent(scale_sigma, 2) });
}
