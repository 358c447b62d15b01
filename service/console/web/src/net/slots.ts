/**
 * Slots limit the concurrent requests. A browser opens at most six connections to one host. Every request except STOP
 * takes one of these slots, so that STOP never waits, and STOP cancels the requests that run. Images leave some slots
 * to the requests for the state of the cell.
 */
const MAX_REQUESTS = 5;
const MAX_PICTURES = 2;

export type Kind = "call" | "picture";

export interface Slot {
  /** Aborted when STOP cancels the requests. */
  signal: AbortSignal;
  /** Free the slot; may be called several times. */
  free(): void;
}

const active = new Map<AbortController, Kind>();
const waiting: Record<Kind, (() => void)[]> = { call: [], picture: [] };

function isFree(kind: Kind): boolean {
  const pictures = [...active.values()].filter((one) => one === "picture").length;
  return active.size < MAX_REQUESTS && (kind === "call" || pictures < MAX_PICTURES);
}

/** Wait for a slot; calls come before images. */
export async function takeSlot(kind: Kind = "call"): Promise<Slot> {
  const controller = new AbortController();
  if (isFree(kind)) active.set(controller, kind);
  else {
    await new Promise<void>((resolve) =>
      waiting[kind].push(() => {
        active.set(controller, kind);
        resolve();
      }),
    );
  }
  return {
    signal: controller.signal,
    free() {
      if (!active.delete(controller)) return;
      const next = waiting.call.shift() ?? (isFree("picture") ? waiting.picture.shift() : undefined);
      next?.();
    },
  };
}

/** Cancel all requests, so that STOP comes first. */
export function cancelAll(): void {
  for (const controller of active.keys()) controller.abort();
}
