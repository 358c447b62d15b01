import { EventSourceParserStream, type EventSourceMessage } from "eventsource-parser/stream";
import { OURS } from "./ours";
import { heard } from "./request";
import { takeSlot } from "./slots";

/** Pings come each 15 s; behind so long a silence the stream is taken for broken. */
const SILENCE_S = 25;

/**
 * Reads server-sent events until the stream ends, and the id of the last. By fetch, not by EventSource, which could
 * neither send our header nor tell why it was refused.
 *
 * @throws the reason why it broke; the status of a refusal is the error's `cause`
 */
export async function readEvents(
  address: string,
  last: string | null,
  ended: AbortSignal,
  event: (message: EventSourceMessage) => void,
): Promise<string | null> {
  const slot = await takeSlot();
  const silent = new AbortController();
  let timer = setTimeout(() => silent.abort(), SILENCE_S * 1000);
  try {
    const headers = { ...OURS, Accept: "text/event-stream", ...(last === null ? {} : { "Last-Event-ID": last }) };
    const answer = await fetch(address, { headers, signal: AbortSignal.any([ended, slot.signal, silent.signal]) });
    if (!answer.ok || answer.body === null) throw new Error("no stream", { cause: answer.status });
    const bytes = answer.body.pipeThrough(
      new TransformStream<Uint8Array<ArrayBuffer>, Uint8Array<ArrayBuffer>>({
        transform(chunk, passed) {
          heard();
          clearTimeout(timer);
          timer = setTimeout(() => silent.abort(), SILENCE_S * 1000);
          passed.enqueue(chunk);
        },
      }),
    );
    const messages = bytes.pipeThrough(new TextDecoderStream()).pipeThrough(new EventSourceParserStream()).getReader();
    for (;;) {
      const { done, value } = await messages.read();
      if (done) return last;
      last = value.id ?? last;
      event(value);
    }
  } finally {
    clearTimeout(timer);
    slot.free();
  }
}
