/**
 * The STOP button. It is loaded before the rest of the page and does not depend on it. It asks no question and is never
 * disabled.
 */
import type { Cell } from "./net/api";
import { CONSOLE_HEADERS } from "./net/headers";
import { cancelAll } from "./net/slots";
import { clock } from "./texts/format";
import { t } from "./texts/translate";

const TIMEOUT_MS = 4000;
/** A stop without an answer after this time is reported as not confirmed. */
const WARN_AFTER_MS = 1500;
/** A stop that does not get through is repeated for this time ... */
const REPEAT_FOR_MS = 60_000;
/** ... with this pause between two requests. */
const REPEAT_PAUSE_MS = 1000;
/** Event for the page: it then requests the state of the cell again. */
export const STOPPED = "pointchain:stopped";

type Message = [kind: "sent" | "good" | "bad", text: string];

const button = document.querySelector<HTMLButtonElement>("#stop");
const output = document.querySelector<HTMLElement>("#stop-message");
let presses = 0;
let sending = false;

function bad(key: "stop.not_yet" | "stop.failed" | "stop.signed_out"): Message {
  return ["bad", t(key)];
}

function show(...[kind, text]: Message): void {
  if (output === null) return;
  output.className = kind;
  output.textContent = text;
}

/** Clear the message about the last stop, unless a stop is being sent. */
export function clearStopMessage(): void {
  if (!sending) show("sent", "");
}

/** Send a stop until it gets through or the button is pressed again. Several stops are harmless. */
async function stop(): Promise<void> {
  const press = ++presses;
  sending = true;
  cancelAll();
  show("sent", t("stop.sending"));
  const until = performance.now() + REPEAT_FOR_MS;
  for (;;) {
    const message = (await sendOnce(press)) ?? (performance.now() > until ? bad("stop.failed") : null);
    if (press !== presses) return; // the next press continues
    if (message !== null) {
      sending = false;
      return show(...message);
    }
    await new Promise((resolve) => setTimeout(resolve, REPEAT_PAUSE_MS));
  }
}

/** Send the stop once. Return the message about its outcome; null means that the outcome is unknown. */
async function sendOnce(press: number): Promise<Message | null> {
  const late = setTimeout(() => press === presses && show(...bad("stop.not_yet")), WARN_AFTER_MS);
  try {
    const answer = await fetch("/api/cell/stop", {
      method: "POST",
      headers: CONSOLE_HEADERS,
      priority: "high",
      keepalive: true,
      signal: AbortSignal.timeout(TIMEOUT_MS),
    });
    if (answer.status === 401 || answer.status === 403) return bad("stop.signed_out");
    if (answer.ok) {
      const cell: Cell = await answer.json();
      dispatchEvent(new Event(STOPPED));
      return outcome(cell);
    }
  } catch {
    // Not sent, or no answer: reported below, and sent again.
  } finally {
    clearTimeout(late);
  }
  if (press === presses) show(...bad("stop.not_yet"));
  return null;
}

/** Return the message about the arm, from the answer of the service. */
function outcome(cell: Cell): Message {
  const time = clock(new Date());
  const reason = cell.problem?.replace("urn:pointchain:", "");
  if (cell.robot.moving === false || reason === "stopped") return ["good", t("stop.stopped", { time })];
  if (reason === "not-connected") return ["sent", t("stop.no_arm", { time })];
  if (reason === "released") return ["bad", t("stop.released", { time })];
  return ["bad", t("stop.unknown", { time })];
}

button?.addEventListener("click", () => void stop());
addEventListener("keydown", (event) => {
  if (event.ctrlKey && event.key === ".") {
    event.preventDefault();
    void stop();
  }
});
