import type { Cell, Method, Scan, ScanState, Verdict } from "../net/api";
import { t } from "./translate";

/** How a state is drawn: each tone has a shape and a colour. */
export type Tone = "good" | "work" | "warn" | "bad" | "none";

export const SHAPES: Record<Tone, string> = { good: "✓", work: "◌", warn: "▲", bad: "⬣", none: "?" };

export const CELL_TONES: Record<Cell["state"], Tone> = { ready: "good", busy: "work", not_ready: "warn", fault: "bad" };

export const SCAN_TONES: Record<ScanState, Tone> = {
  queued: "work",
  connecting: "work",
  preflight: "work",
  scanning: "work",
  processing: "work",
  stopping: "warn",
  succeeded: "good",
  partial: "warn",
  failed: "bad",
  aborted: "warn",
  interrupted: "warn",
};

/** How the verdict on a model, or on a part of it, is drawn. */
export const VERDICT_TONES: Record<Verdict, Tone> = { accept: "good", review: "warn", refuse: "bad" };

/** The methods of recognition, the recommended one first. */
export const METHODS: readonly Method[] = ["graph", "enhanced", "matching"];

/** The verdict of the service on a calibration. */
export type VerdictCode = "accept" | "warn" | "refuse";

/** Return the name of a scan's or run's state. */
export function scanWord(state: ScanState): string {
  return t(`scan_state.${state}`);
}

/** Return the outcome of a scan. It is good only if there is no doubt about the result, and something to grasp. */
export function outcome({ state, summary }: Scan): { word: string; tone: Tone } {
  if (summary === null) return { word: scanWord(state), tone: state === "succeeded" ? "none" : SCAN_TONES[state] };
  if (summary.verdict === "refuse") return { word: t("scan_state.refuse"), tone: "bad" };
  if (summary.chains === 0) return { word: t("scan_state.no_string"), tone: "warn" };
  if (summary.verdict === "review" && (state === "succeeded" || state === "partial")) {
    return { word: t(`scan_state.${state}_review`), tone: "warn" };
  }
  return { word: scanWord(state), tone: SCAN_TONES[state] };
}

/** Return whether a scan or run in this state continues. */
export function isActive(state: ScanState): boolean {
  return ["queued", "connecting", "preflight", "scanning", "processing", "stopping"].includes(state);
}

/** Return whether a scan has a model. */
export function hasModel(scan: Scan): boolean {
  return scan.links.model !== null;
}

/** Return the kind of a scan, for people. */
export function kindOf(scan: Scan): string {
  if (scan.source !== null) return t("scan_kind.reprocessed");
  return t(`scan_kind.${scan.mode}`);
}

/** Return whether a scan is of a recording that a person chose: not of this table, or not of its current state. */
export function isElsewhere(scan: Scan): boolean {
  return scan.mode === "replay" && scan.source === null;
}

/** Return the number of views that a live scan has recorded so far. */
export function recordedViews(scan: Scan): number {
  return scan.progress.views.filter((view) => view.state === "recorded").length;
}

/** Return whether a live scan has recorded too few views for a model, by any method. */
export function tooFew(scan: Scan): boolean {
  return scan.mode === "live" && recordedViews(scan) < 2;
}

/** Return the strings and crossings that a scan found, for people. */
export function foundText(strings: number, crossings: number): string {
  return t("units.strings_and_crossings", {
    strings: t("units.strings", { count: strings }),
    crossings: t("units.crossings", { count: crossings }),
  });
}

/** Return the verdict on a calibration, for people; null: it was never judged. */
export function verdictWord(verdict: VerdictCode | null): string {
  return t(`verdict.${verdict ?? "none"}`);
}
