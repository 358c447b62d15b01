/**
 * A browser opens at most six connections to one host; the next request waits until one of them is free. So that Stop
 * never waits, all else takes one of a few slots, and Stop has the others given up.
 */
const MOST = 4;

interface Slot {
  /** Aborted when what is under way is given up. */
  signal: AbortSignal;
  /** Lets the next one have it; may be called again. */
  free(): void;
}

const underWay = new Set<AbortController>();
const waiting: (() => void)[] = [];
let taken = 0;

/** Waits for a slot. What is asked for by `first` comes before all that waits. */
export async function takeSlot(first = false): Promise<Slot> {
  if (taken < MOST) taken++;
  else await new Promise<void>((resolve) => (first ? waiting.unshift(resolve) : waiting.push(resolve)));
  const controller = new AbortController();
  underWay.add(controller);
  return {
    signal: controller.signal,
    free() {
      if (!underWay.delete(controller)) return;
      const next = waiting.shift();
      if (next) next();
      else taken--;
    },
  };
}

/** Ends all that is under way, for Stop to come first. */
export function giveUpAll(): void {
  for (const controller of underWay) controller.abort();
}
