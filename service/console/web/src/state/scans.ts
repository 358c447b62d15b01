import { computed, signal } from "@preact/signals";
import { api, resultOf, type Scan } from "../net/api";
import { isActive } from "../texts/states";
import { now } from "./freshness";

/** Number of scans that are requested: several may recognise an earlier one again. */
const LISTED = 10;

/** The scan that runs, or the last one; null: there is none. */
export const latest = signal<Scan | null>(null);
/** ID of the last live scan that ran while this page was open; null: there was none. */
export const followed = signal<string | null>(null);
/** Whether a scan was asked for, and the service has not answered yet. */
export const requesting = signal(false);
/** The newest scan that does not recognise an earlier one again; null: there is none. */
export const latestOriginal = signal<Scan | null>(null);
/** Incremented whenever a scan starts or ends, so that lists are requested again. */
export const changes = signal(0);

/** The scan that runs, no matter who started it. */
export const running = computed(() => (latest.value !== null && isActive(latest.value.state) ? latest.value : null));

/** Incremented with each shown change: an answer to an earlier request may be older. */
let version = 0;

/** Request the newest scan, and the newest one that is not a repeated recognition. */
export async function refreshScans(): Promise<void> {
  const before = version;
  const { scans } = await resultOf(api.GET("/api/scans", { params: { query: { limit: LISTED } } }));
  if (version !== before) return; // requested again soon
  const [newest] = scans;
  latestOriginal.value = scans.find((scan) => scan.source === null) ?? latestOriginal.value;
  if (newest !== undefined) show(newest);
}

/** Show the reported state of a scan. */
export function show(scan: Scan): void {
  const before = latest.value;
  // An ended scan does not continue: this is an earlier event, sent again.
  if (before?.id === scan.id && isActive(scan.state) && !isActive(before.state)) return;
  version++;
  latest.value = scan;
  if (isActive(scan.state) && scan.mode === "live") followed.value = scan.id;
  if (scan.source === null) latestOriginal.value = scan;
  if (before?.id !== scan.id || isActive(before.state) !== isActive(scan.state)) changes.value++;
}

const received = computed(() => ({ scan: running.value, at: performance.now() }));

/** Seconds since the first move of the running scan, and to its model; null: not known. */
export const scanTime = computed(() => {
  const { scan, at } = received.value;
  const { elapsed_s, remaining_s } = scan?.progress ?? { elapsed_s: null, remaining_s: null };
  const since_s = Math.max(0, (now.value - at) / 1000);
  return {
    elapsed: elapsed_s === null ? null : elapsed_s + since_s,
    remaining: remaining_s === null ? null : Math.max(0, remaining_s - since_s),
  };
});

/** An event of the stream of all scans. */
export type ScanEvent =
  | { kind: "state"; scan: string; data: Pick<Scan, "state" | "problem" | "summary"> & Stage }
  | { kind: "progress"; scan: string; data: Stage }
  | { kind: "view"; scan: string; data: Scan["progress"]["views"][number] };

interface Stage {
  stage: string | null;
  fraction: number;
}

/** Apply an event; request what it does not contain, such as the scan's links. */
export async function scanEvent(event: ScanEvent): Promise<void> {
  const scan = latest.value;
  if (scan === null || scan.id !== event.scan) {
    if (event.kind === "state") await refreshScans();
    return;
  }
  if (event.kind === "view") {
    const others = scan.progress.views.filter((view) => view.index !== event.data.index);
    const views = [...others, event.data].sort((a, b) => a.index - b.index);
    return show({ ...scan, progress: { ...scan.progress, views } });
  }
  const { stage, fraction } = event.data;
  const progress = { ...scan.progress, stage, fraction };
  if (event.kind === "progress") return show({ ...scan, progress });
  const { state, problem, summary } = event.data;
  show({ ...scan, state, problem, summary, progress });
  await refreshScan(scan.id);
}

/** Request one scan, and show it. */
async function refreshScan(id: string): Promise<void> {
  const before = version;
  const answer = await resultOf(api.GET("/api/scans/{id}", { params: { path: { id } } }));
  if (version === before) show(answer);
}
