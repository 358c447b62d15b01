import { computed, signal, type ReadonlySignal } from "@preact/signals";
import { LostError, GivenUpError } from "../net/request";
import { RefusedError } from "../net/api";
import { readEvents } from "../net/events";
import { STOPPED } from "../stop";
import { askCalibration, askCell, atWork, cellEvent } from "./cell";
import { askRoom, room } from "./room";
import { askScans, running, scanEvent, type ScanNews } from "./scans";
import { askSession, caller } from "./session";

const IDLE_MS = 2000;
const BUSY_MS = 700;
/** What changes seldom is asked for seldom. */
const SLOW_MS = 60_000;
const AGAIN_MS = [1000, 2000, 4000, 5000];

/** How news come: at once, or when they are asked for. */
export const live = signal(false);

const seen = signal(!document.hidden);
/** A hidden page follows no events: browsers have few connections to share among their tabs. */
const wanted = computed(() => Boolean(caller.value) && seen.value);

let hurry: (() => void) | null = null;
/** What is being asked for just now may be answered as it was before: it is asked for once more. */
let due = false;

/** Asks for everything now, not only when its time has come. */
export function askNow(): void {
  due = true;
  hurry?.();
}

/** Keeps the page up to date, for as long as it is open. */
export function follow(): void {
  void askAgainAndAgain();
  void listenAgainAndAgain();
  addEventListener(STOPPED, askNow);
  addEventListener("online", askNow);
  document.addEventListener("visibilitychange", () => {
    seen.value = !document.hidden;
    if (seen.value) askNow();
  });
}

async function askAgainAndAgain(): Promise<never> {
  let slowAt = performance.now();
  for (;;) {
    due = false;
    await quietly(async () => {
      if (!caller.value) return askSession();
      await askCell();
      await askScans();
      if (room.value === null) await askRoom();
      if (performance.now() - slowAt > SLOW_MS) {
        slowAt = performance.now();
        await askCalibration();
        await askSession();
      }
    });
    if (!due) await rest(atWork.value || running.value !== null ? BUSY_MS : IDLE_MS);
  }
}

/** Waits, unless somebody is in a hurry. */
function rest(milliseconds: number): Promise<void> {
  return new Promise((resolve) => {
    const timer = setTimeout(resolve, milliseconds);
    hurry = () => {
      clearTimeout(timer);
      resolve();
    };
  });
}

/** What fails here is told by how old the page's last answer is, and tried again. */
async function quietly(work: () => Promise<void>): Promise<void> {
  try {
    await work();
  } catch (error) {
    if (error instanceof RefusedError && error.slug === "unauthorized") caller.value = null;
    else if (!(error instanceof LostError || error instanceof GivenUpError || error instanceof RefusedError)) reportError(error);
  }
}

async function listenAgainAndAgain(): Promise<never> {
  let last: string | null = null;
  for (let failures = 0; ; ) {
    await until(wanted);
    const unwanted = new AbortController();
    const end = wanted.subscribe((still) => still || unwanted.abort());
    try {
      last = await readEvents("/api/events", last, unwanted.signal, (message) => {
        failures = 0;
        live.value = true;
        void quietly(() => hear(message.event ?? "", message.data));
      });
    } catch (error) {
      // An id that the service does not know, as of another data folder, would be refused for ever.
      if (error instanceof Error && error.cause === 422) last = null;
    } finally {
      live.value = false;
      end();
    }
    await new Promise((resolve) => setTimeout(resolve, AGAIN_MS[Math.min(failures++, AGAIN_MS.length - 1)]));
  }
}

async function hear(event: string, data: string): Promise<void> {
  if (event === "cell") {
    cellEvent(JSON.parse(data));
    askNow(); // for what the event does not tell
  } else if (event === "resync") await askScans();
  else await scanEvent(JSON.parse(data) as ScanNews);
}

/** Returns once it is so. */
function until(condition: ReadonlySignal<boolean>): Promise<void> {
  return new Promise((resolve) => {
    const end = condition.subscribe((met) => {
      if (!met) return;
      queueMicrotask(() => end());
      resolve();
    });
  });
}
