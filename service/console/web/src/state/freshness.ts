import { computed, signal } from "@preact/signals";
import { heardAt } from "../net/request";

/** Behind so long without an answer, what is shown is taken for old. */
const LOST_S = 4;

/** Ticks each second. */
export const now = signal(performance.now());
setInterval(() => (now.value = performance.now()), 1000);

const began = performance.now();

/** Since when nothing was heard of the service, in seconds. */
export const silent_s = computed(() => Math.max(0, (now.value - (heardAt.value ?? began)) / 1000));

/** The service does not answer: what is shown is old. */
export const lost = computed(() => silent_s.value > LOST_S);

/** When it was heard last. */
export function lastHeard(): Date | null {
  return heardAt.value === null ? null : new Date(Date.now() - (performance.now() - heardAt.value));
}
