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

/** A word for an outcome, and how it is drawn. */
export interface Outcome {
  word: string;
  tone: Tone;
}

/** What decides whether a program may use a result. */
interface Judged {
  verdict: Verdict;
  strings: number;
  /** Number of doubts and blocking findings. */
  doubts: number;
  /** Views are missing. */
  partial: boolean;
}

/** Return the outcome of a result. It is good only without any doubt, with all views, and with something to grasp. */
export function resultOutcome({ verdict, strings, doubts, partial }: Judged): Outcome {
  if (verdict === "refuse") return { word: t("outcome.refuse"), tone: "bad" };
  if (strings === 0) return { word: t("outcome.no_string"), tone: "warn" };
  const accepted = verdict === "accept" && doubts === 0;
  const word = accepted ? t("outcome.accept") : t("outcome.review");
  if (partial) return { word: t("outcome.views_missing", { outcome: word }), tone: "warn" };
  return { word, tone: accepted ? "good" : "warn" };
}

/** Return the outcome of a scan. */
export function outcome({ state, summary }: Scan): Outcome {
  if (summary === null) return { word: scanWord(state), tone: state === "succeeded" ? "none" : SCAN_TONES[state] };
  const { verdict, chains, doubt_count } = summary;
  const unusable = verdict === "refuse" || chains === 0;
  if (!unusable && state !== "succeeded" && state !== "partial") return { word: scanWord(state), tone: SCAN_TONES[state] };
  return resultOutcome({ verdict, strings: chains, doubts: doubt_count, partial: state === "partial" });
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
