import { EventSourceParserStream, type EventSourceMessage } from "eventsource-parser/stream";
import { CONSOLE_HEADERS } from "./headers";
import { markAnswered } from "./request";
import { takeSlot } from "./slots";

/** A ping arrives every 15 s; after this silence the stream counts as broken. */
const SILENCE_S = 25;

/**
 * Read server-sent events until the stream ends, and return the id of the last one. `EventSource` could neither send
 * the console's header nor report why it was refused.
 *
 * @throws the reason why the stream broke; the status of a refusal is the error's `cause`
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
    const headers = { ...CONSOLE_HEADERS, Accept: "text/event-stream", ...(last === null ? {} : { "Last-Event-ID": last }) };
    const answer = await fetch(address, { headers, signal: AbortSignal.any([ended, slot.signal, silent.signal]) });
    if (!answer.ok || answer.body === null) throw new Error("no stream", { cause: answer.status });
    const bytes = answer.body.pipeThrough(
      new TransformStream<Uint8Array<ArrayBuffer>, Uint8Array<ArrayBuffer>>({
        transform(chunk, passed) {
          markAnswered();
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
