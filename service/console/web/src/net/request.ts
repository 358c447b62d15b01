import { signal } from "@preact/signals";
import { takeSlot } from "./slots";

/** The service answered so long ago: `performance.now()`; null: never yet. */
export const heardAt = signal<number | null>(null);

/** The service did not answer, or not in time. */
export class LostError extends Error {}

/** Given up, because Stop was pressed or nobody wants the answer any more. */
export class GivenUpError extends Error {}

const WITHOUT_BODY = new Set([204, 205, 304]);
const USUAL_S = 20;

/** Says that the service has answered just now. */
export function heard(): void {
  heardAt.value = performance.now();
}

/**
 * `fetch` in one of the slots, with a time limit; reads the whole answer there.
 *
 * @throws LostError, GivenUpError
 */
export async function request(asked: Request, limit_s = USUAL_S): Promise<Response> {
  const slot = await takeSlot();
  const timeout = AbortSignal.timeout(limit_s * 1000);
  try {
    const answer = await fetch(asked, { signal: AbortSignal.any([asked.signal, slot.signal, timeout]) });
    const body = await answer.arrayBuffer();
    heard();
    return new Response(WITHOUT_BODY.has(answer.status) ? null : body, answer);
  } catch (error) {
    if (slot.signal.aborted || asked.signal.aborted) throw new GivenUpError("given up");
    throw new LostError(timeout.aborted ? `no answer within ${limit_s} s` : "the service does not answer", {
      cause: error,
    });
  } finally {
    slot.free();
  }
}
