/**
 * A browser opens at most six connections to one host; the next request waits until one of them is free. So that Stop
 * never waits, all else takes one of a few slots, and Stop has the others given up. Pictures leave some of the slots to
 * what tells the state of the cell.
 */
const MOST = 5;
const MOST_PICTURES = 2;

export type Kind = "call" | "picture";

export interface Slot {
  /** Aborted when what is under way is given up. */
  signal: AbortSignal;
  /** Lets the next one have it; may be called again. */
  free(): void;
}

const underWay = new Map<AbortController, Kind>();
const waiting: Record<Kind, (() => void)[]> = { call: [], picture: [] };

function isFree(kind: Kind): boolean {
  const pictures = [...underWay.values()].filter((one) => one === "picture").length;
  return underWay.size < MOST && (kind === "call" || pictures < MOST_PICTURES);
}

/** Waits for a slot; calls come before pictures. */
export async function takeSlot(kind: Kind = "call"): Promise<Slot> {
  const controller = new AbortController();
  if (isFree(kind)) underWay.set(controller, kind);
  else {
    await new Promise<void>((resolve) =>
      waiting[kind].push(() => {
        underWay.set(controller, kind);
        resolve();
      }),
    );
  }
  return {
    signal: controller.signal,
    free() {
      if (!underWay.delete(controller)) return;
      const next = waiting.call.shift() ?? (isFree("picture") ? waiting.picture.shift() : undefined);
      next?.();
    },
  };
}

/** Ends all that is under way, for Stop to come first. */
export function giveUpAll(): void {
  for (const controller of underWay.keys()) controller.abort();
}
