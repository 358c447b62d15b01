/**
 * The Stop button. It is there before all else of the page, needs nothing of it, asks nothing, and is never disabled.
 */
import type { Cell } from "./net/api";
import { OURS } from "./net/ours";
import { giveUpAll } from "./net/slots";
import { clock } from "./words/units";

const LIMIT_MS = 4000;
/** An answer takes less than this, or something is wrong. */
const SOON_MS = 1500;
/** A stop that does not get through is tried for so long ... */
const PATIENCE_MS = 60_000;
/** ... and again after so long. */
const AGAIN_MS = 1000;
/** Told to the page, which asks for the cell anew. */
export const STOPPED = "pointchain:stopped";

type Said = ["sent" | "good" | "bad", string];

const NOT_YET: Said = ["bad", "STOP HAS NOT GOT THROUGH YET. Use the emergency stop of the robot. It is sent again and again."];
const GIVEN_UP: Said = ["bad", "STOP DID NOT GET THROUGH, and is sent no more. Use the emergency stop, or press again."];
const NOBODY: Said = ["bad", "NOT STOPPED: nobody is signed in here. Use the emergency stop."];

const button = document.querySelector<HTMLButtonElement>("#stop");
const told = document.querySelector<HTMLElement>("#stop-told");
let presses = 0;
let sending = false;

function say(...[kind, words]: Said): void {
  if (told === null) return;
  told.className = kind;
  told.textContent = words;
}

/** What was said of the last stop is over: the arm is at work again, or somebody else is here. */
export function forgetStop(): void {
  if (!sending) say("sent", "");
}

/** Sends a stop until it gets through, or is pressed again; more than one is harmless. */
async function stop(): Promise<void> {
  const press = ++presses;
  sending = true;
  giveUpAll();
  say("sent", "Stop is sent ...");
  const until = performance.now() + PATIENCE_MS;
  for (;;) {
    const said = (await once(press)) ?? (performance.now() > until ? GIVEN_UP : null);
    if (press !== presses) return; // the next press goes on
    if (said !== null) {
      sending = false;
      return say(...said);
    }
    await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
  }
}

/** Sends it once: what is to be said of it; null: nobody knows whether it was taken. */
async function once(press: number): Promise<Said | null> {
  const late = setTimeout(() => press === presses && say(...NOT_YET), SOON_MS);
  try {
    const answer = await fetch("/api/cell/stop", {
      method: "POST",
      headers: OURS,
      priority: "high",
      keepalive: true,
      signal: AbortSignal.timeout(LIMIT_MS),
    });
    if (answer.status === 401 || answer.status === 403) return NOBODY;
    if (answer.ok) {
      const cell: Cell = await answer.json();
      dispatchEvent(new Event(STOPPED));
      return outcome(cell);
    }
  } catch {
    // Not sent, or no answer: that is said below, and it is sent once more.
  } finally {
    clearTimeout(late);
  }
  if (press === presses) say(...NOT_YET);
  return null;
}

/** What the answer tells of the arm; where the service does not know how it stands, that is said. */
function outcome(cell: Cell): Said {
  const at = clock(new Date());
  const why = cell.problem?.replace("urn:pointchain:", "");
  if (cell.robot.moving === false || why === "stopped") return ["good", `The arm was stopped, ${at}.`];
  if (why === "not-connected" || why === "released") return ["sent", `Stop sent, ${at}. No arm is connected, so none was stopped.`];
  return ["bad", `Stop sent, ${at}, but nobody knows how the arm stands. Look at it.`];
}

button?.addEventListener("click", () => void stop());
addEventListener("keydown", (event) => {
  if (event.ctrlKey && event.key === ".") {
    event.preventDefault();
    void stop();
  }
});
