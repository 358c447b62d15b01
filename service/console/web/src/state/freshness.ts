import { computed, signal } from "@preact/signals";
import { answeredAt } from "../net/request";

/** After this time without an answer, the shown state counts as outdated. */
const LOST_S = 4;

/** Updated each second. */
export const now = signal(performance.now());
setInterval(() => (now.value = performance.now()), 1000);

const started = performance.now();

/** Time since the last answer of the service, seconds. */
export const silence_s = computed(() => Math.max(0, (now.value - (answeredAt.value ?? started)) / 1000));

/** Whether the service does not answer: the shown state is outdated. */
export const lost = computed(() => silence_s.value > LOST_S);

/** Return the time of the last answer. */
export function lastAnswer(): Date | null {
  return answeredAt.value === null ? null : new Date(Date.now() - (performance.now() - answeredAt.value));
}
