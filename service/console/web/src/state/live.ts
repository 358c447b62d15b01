import { signal } from "@preact/signals";

/** Whether events arrive at once; otherwise the page polls. */
export const live = signal(false);
