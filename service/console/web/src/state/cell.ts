import { computed, signal } from "@preact/signals";
import { api, slugOf, told, type Calibration, type Cell } from "../net/api";

/** The cell as last told; null: not asked yet. */
export const cell = signal<Cell | null>(null);
/** The calibration in use, as last told. */
export const calibration = signal<Calibration | null>(null);

/** Why the cell is not ready, in one word. */
export const why = computed(() => (cell.value?.problem ? slugOf(cell.value.problem) : null));

/** The arm moves, or may begin to at any moment. */
export const atWork = computed(() => cell.value?.state === "busy" || cell.value?.robot.moving === true);

/** A calibration or verification is under way: no scan can be begun. */
export const calibrates = computed(() => Boolean(calibration.value?.under_way));

/** Asks for the cell. */
export async function askCell(): Promise<void> {
  const [heard, before] = [events, cell.value?.calibration?.sha256];
  const asked = await told(api.GET("/api/cell"));
  if (events !== heard) return; // it may be older than what was heard meanwhile, and is asked for again at once
  cell.value = asked;
  const other = cell.value.calibration?.sha256 !== before;
  if (calibration.value === null || other || calibrates.value || cell.value.state === "busy") await askCalibration();
}

/** Asks for the calibration in use: its age, its verdict, what recent scans tell of it. */
export async function askCalibration(): Promise<void> {
  calibration.value = await told(api.GET("/api/calibration"));
}

let events = 0;

/** Takes over what an event tells of the cell, ahead of the next answer. */
export function cellEvent(news: Pick<Cell, "state" | "problem" | "reason">): void {
  events++;
  if (cell.value !== null) cell.value = { ...cell.value, ...news };
}
