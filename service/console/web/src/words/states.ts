import type { Cell, Scan, ScanState } from "../net/api";

/** How a state looks: each has a word, a shape and a colour. */
export type Look = "good" | "work" | "warn" | "bad" | "none";

export const SHAPES: Record<Look, string> = { good: "✓", work: "◌", warn: "▲", bad: "⬣", none: "?" };

export const CELL: Record<Cell["state"], { word: string; look: Look }> = {
  ready: { word: "Ready", look: "good" },
  busy: { word: "Working", look: "work" },
  not_ready: { word: "Not ready", look: "warn" },
  fault: { word: "Look at the cell", look: "bad" },
};

export const SCAN: Record<ScanState, { word: string; look: Look }> = {
  queued: { word: "Waiting", look: "work" },
  preflight: { word: "Checking the cell", look: "work" },
  scanning: { word: "Looking", look: "work" },
  processing: { word: "Working out the shape", look: "work" },
  stopping: { word: "Stopping", look: "warn" },
  succeeded: { word: "Done", look: "good" },
  partial: { word: "Done, views are missing", look: "warn" },
  failed: { word: "Failed", look: "bad" },
  aborted: { word: "Stopped", look: "warn" },
  interrupted: { word: "The service was restarted", look: "warn" },
};

/** What came of a scan; one that found no string went well, but there is nothing to grasp. */
export function outcome(scan: Scan): { word: string; look: Look } {
  return scan.summary?.chains === 0 ? { word: "No string found", look: "warn" } : SCAN[scan.state];
}

/** Whether it goes on. */
export function underWay(state: ScanState): boolean {
  return ["queued", "preflight", "scanning", "processing", "stopping"].includes(state);
}

/** Whether there is a model of it. */
export function hasModel(scan: Scan): boolean {
  return scan.links.model !== null;
}

/** What kind of scan it is, in words. */
export function kindOf(scan: Scan): string {
  if (scan.source !== null) return "Worked out again";
  return scan.mode === "live" ? "By the cell" : "From a recording";
}

/** Whether it is of a recording that somebody has chosen: of no table that is here, or not as it is now. */
export function isElsewhere(scan: Scan): boolean {
  return scan.mode === "replay" && scan.source === null;
}

/** How many views a live scan has taken so far. */
export function takenIn(scan: Scan): number {
  return scan.progress.views.filter((view) => view.state === "recorded").length;
}

/** Whether a live scan has taken too few views for a model, however they are worked out. */
export function tooFew(scan: Scan): boolean {
  return scan.mode === "live" && takenIn(scan) < 2;
}

/** A name of the service's, as `protective_stop`, in words. */
export function words(name: string): string {
  return name.replaceAll("_", " ");
}

export const METHODS: Record<Scan["method"], { name: string; hint: string }> = {
  graph: { name: "graph", hint: "Our own: follows the strands through all views. Take this one." },
  enhanced: { name: "enhanced", hint: "The paper's better method: also joins what is hidden under a crossing." },
  matching: { name: "matching", hint: "The paper's plain method: joins neighbouring points." },
};

/** Why no scan can be begun. */
export const CALIBRATES = "A calibration or verification is under way: wait for its end, or cancel it there.";

/** What is thought of a calibration. */
export const VERDICTS = { accept: "good", warn: "usable, with warnings", refuse: "must not be used" } as const;
