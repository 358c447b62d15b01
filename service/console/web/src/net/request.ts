import { signal } from "@preact/signals";
import { takeSlot } from "./slots";

/** When the service answered last, as `performance.now()`; null: never. */
export const answeredAt = signal<number | null>(null);

/** The service did not answer, or not in time. */
export class NoAnswerError extends Error {
  constructor(
    /** The time limit that was exceeded, seconds; null: the connection failed. */
    readonly timeout_s: number | null,
    options: ErrorOptions,
  ) {
    super("no answer", options);
  }
}

/** The request was cancelled, because STOP was pressed or its answer is no longer needed. */
export class CancelledError extends Error {}

const WITHOUT_BODY = new Set([204, 205, 304]);
const DEFAULT_LIMIT_S = 20;

/** Record that the service has just answered. */
export function markAnswered(): void {
  answeredAt.value = performance.now();
}

/**
 * Call `fetch` in one of the slots, with a time limit, and read the whole answer.
 *
 * @throws NoAnswerError, CancelledError
 */
export async function request(call: Request, limit_s = DEFAULT_LIMIT_S): Promise<Response> {
  const slot = await takeSlot();
  const timeout = AbortSignal.timeout(limit_s * 1000);
  try {
    const answer = await fetch(call, { signal: AbortSignal.any([call.signal, slot.signal, timeout]) });
    const body = await answer.arrayBuffer();
    markAnswered();
    return new Response(WITHOUT_BODY.has(answer.status) ? null : body, answer);
  } catch (error) {
    if (slot.signal.aborted || call.signal.aborted) throw new CancelledError("cancelled");
    throw new NoAnswerError(timeout.aborted ? limit_s : null, { cause: error });
  } finally {
    slot.free();
  }
}
