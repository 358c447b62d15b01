import { computed, signal } from "@preact/signals";
import { api, resultOf, type Calibration, type Cell } from "../net/api";
import { slugOf } from "../texts/problem";

/** The last known state of the cell; null: not requested yet. */
export const cell = signal<Cell | null>(null);
/** The last known active calibration. */
export const calibration = signal<Calibration | null>(null);

/** Slug of the problem because of which the cell is not ready. */
export const problemSlug = computed(() => (cell.value?.problem ? slugOf(cell.value.problem) : null));

/** Whether the arm moves, or may start to move at any moment. */
export const atWork = computed(() => cell.value?.state === "busy" || cell.value?.robot.moving === true);

/** Whether a calibration or verification runs: no scan can be started. */
export const calibrating = computed(() => Boolean(calibration.value?.active_run));

/** Request the state of the cell. */
export async function refreshCell(): Promise<void> {
  const [eventsBefore, before] = [events, cell.value?.calibration?.sha256];
  const answer = await resultOf(api.GET("/api/cell"));
  if (events !== eventsBefore) return; // the answer may be older than the event; the state is requested again at once
  cell.value = answer;
  const changed = cell.value.calibration?.sha256 !== before;
  if (calibration.value === null || changed || calibrating.value || cell.value.state === "busy") await refreshCalibration();
}

/** Request the active calibration: its age, its verdict and its drift. */
export async function refreshCalibration(): Promise<void> {
  calibration.value = await resultOf(api.GET("/api/calibration"));
}

let events = 0;

/** Apply an event of the cell, before the next answer. */
export function cellEvent(change: Pick<Cell, "state" | "problem" | "reason">): void {
  events++;
  if (cell.value !== null) cell.value = { ...cell.value, ...change };
}
