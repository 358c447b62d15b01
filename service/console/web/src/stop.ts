/**
 * The Stop button. It is there before all else of the page, needs nothing of it, asks nothing, and is never disabled.
 */
import type { Cell } from "./net/api";
import { OURS } from "./net/ours";
import { giveUpAll } from "./net/slots";
import { clock } from "./words/units";

const LIMIT_MS = 4000;
const TRIES = 2;
/** Told to the page, which asks for the cell anew. */
export const STOPPED = "pointchain:stopped";

const button = document.querySelector<HTMLButtonElement>("#stop");
const told = document.querySelector<HTMLElement>("#stop-told");
let presses = 0;

function say(kind: "sent" | "good" | "bad", words: string): void {
  if (told === null) return;
  told.className = kind;
  told.textContent = words;
}

/** What was said of the last stop is over: the arm is at work again. */
export function forgetStop(): void {
  say("sent", "");
}

/** Sends a stop; a second try is harmless. */
async function stop(): Promise<void> {
  const press = ++presses;
  const latest = (kind: "sent" | "good" | "bad", words: string) => {
    if (press === presses) say(kind, words);
  };
  giveUpAll();
  latest("sent", "Stop is sent ...");
  for (let k = 0; k < TRIES; k++) {
    try {
      const answer = await fetch("/api/cell/stop", {
        method: "POST",
        headers: OURS,
        priority: "high",
        keepalive: true,
        signal: AbortSignal.timeout(LIMIT_MS),
      });
      if (answer.ok) {
        const cell: Cell = await answer.json();
        latest(...outcome(cell));
        dispatchEvent(new Event(STOPPED));
        return;
      }
      if (answer.status === 401 || answer.status === 403) {
        latest("bad", "NOT STOPPED: nobody is signed in here. Use the emergency stop.");
        return;
      }
    } catch {
      // Not sent, or no answer: once more, then it is told.
    }
  }
  latest("bad", "STOP DID NOT GET THROUGH. Use the emergency stop of the robot.");
}

/** What the answer tells of the arm; where the service does not know how it stands, that is said. */
function outcome(cell: Cell): ["good" | "sent" | "bad", string] {
  const at = clock(new Date());
  const why = cell.problem?.replace("urn:pointchain:", "");
  if (cell.robot.moving === false || why === "stopped") return ["good", `The arm was stopped, ${at}.`];
  if (why === "not-connected" || why === "released") return ["sent", `Stop sent, ${at}. No arm is connected here.`];
  return ["bad", `Stop sent, ${at}, but nobody knows how the arm stands. Look at it.`];
}

button?.addEventListener("click", () => void stop());
addEventListener("keydown", (event) => {
  if (event.ctrlKey && event.key === ".") {
    event.preventDefault();
    void stop();
  }
});
