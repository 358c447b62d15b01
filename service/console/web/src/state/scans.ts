import { computed, signal } from "@preact/signals";
import { api, told, type Scan } from "../net/api";
import { underWay } from "../words/states";

/** So many are asked for: behind one scan there may be some that work it out again. */
const SOME = 10;

/** The scan that is shown under way, or was last; null: there is none. */
export const latest = signal<Scan | null>(null);
/** The newest that does not work out an earlier one again; null: there is none. */
export const first = signal<Scan | null>(null);
/** Goes up whenever a scan has begun or ended, so that lists ask anew. */
export const changes = signal(0);

/** The scan under way, whoever has started it. */
export const running = computed(() => (latest.value !== null && underWay(latest.value.state) ? latest.value : null));

/** Goes up with all that is shown: an answer to what was asked before may be older than that. */
let version = 0;

/** Asks which scan is the newest, and which has looked at the table or at a recording itself. */
export async function askScans(): Promise<void> {
  const before = version;
  const { scans } = await told(api.GET("/api/scans", { params: { query: { limit: SOME } } }));
  if (version !== before) return; // it is asked for again soon
  const [newest] = scans;
  first.value = scans.find((scan) => scan.source === null) ?? first.value;
  if (newest !== undefined) show(newest);
}

/** Shows a scan, as it was told. */
export function show(scan: Scan): void {
  const before = latest.value;
  // What has ended goes on no more: that is an event of before, sent again.
  if (before?.id === scan.id && underWay(scan.state) && !underWay(before.state)) return;
  version++;
  latest.value = scan;
  if (scan.source === null) first.value = scan;
  if (before?.id !== scan.id || underWay(before.state) !== underWay(scan.state)) changes.value++;
}

/** An event of the stream of all scans. */
export type ScanNews =
  | { kind: "state"; scan: string; data: Pick<Scan, "state" | "problem" | "summary"> & Stage }
  | { kind: "progress"; scan: string; data: Stage }
  | { kind: "view"; scan: string; data: Scan["progress"]["views"][number] };

interface Stage {
  stage: string | null;
  fraction: number;
}

/** Takes over what an event tells; what it does not tell, as a scan's links, is asked for. */
export async function scanEvent(news: ScanNews): Promise<void> {
  const scan = latest.value;
  if (scan === null || scan.id !== news.scan) {
    if (news.kind === "state") await askScans();
    return;
  }
  if (news.kind === "view") {
    const others = scan.progress.views.filter((view) => view.index !== news.data.index);
    const views = [...others, news.data].sort((a, b) => a.index - b.index);
    return show({ ...scan, progress: { ...scan.progress, views } });
  }
  const { stage, fraction } = news.data;
  const state = news.kind === "state" ? news.data.state : scan.state;
  show({ ...scan, state, progress: { ...scan.progress, stage, fraction } });
  if (news.kind === "state") await askScan(scan.id);
}

/** Asks for one scan, and shows it. */
async function askScan(id: string): Promise<void> {
  const before = version;
  const asked = await told(api.GET("/api/scans/{id}", { params: { path: { id } } }));
  if (version === before) show(asked);
}
