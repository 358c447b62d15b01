import { computed, signal, type ReadonlySignal } from "@preact/signals";
import { NoAnswerError, CancelledError } from "../net/request";
import { RefusedError } from "../net/api";
import { readEvents } from "../net/events";
import { STOPPED } from "../stop";
import { refreshCalibration, refreshCell, atWork, cellEvent } from "./cell";
import { armEvent } from "./arm";
import { loadGeometry, geometry } from "./geometry";
import { live } from "./live";
import { refreshScans, running, scanEvent, type ScanEvent } from "./scans";
import { refreshSession, caller } from "./session";

const IDLE_MS = 2000;
const BUSY_MS = 700;
/** Interval of requests for data that rarely changes. */
const SLOW_MS = 60_000;
const RETRY_MS = [1000, 2000, 4000, 5000];

const visible = signal(!document.hidden);
/** Whether the cell and its newest scan are known. */
export const loaded = signal(false);
/** Whether to follow events. A hidden page does not: the tabs of a browser share few connections. */
const following = computed(() => Boolean(caller.value) && visible.value);

let wake: (() => void) | null = null;
/** Whether to poll again at once: the running request may return an earlier state. */
let due = false;

/** Request everything now, not only at the next interval. */
export function refreshNow(): void {
  due = true;
  wake?.();
}

/** Keep the page up to date as long as it is open. */
export function startUpdates(): void {
  void poll();
  void listen();
  addEventListener(STOPPED, refreshNow);
  addEventListener("online", refreshNow);
  document.addEventListener("visibilitychange", () => {
    visible.value = !document.hidden;
    if (visible.value) refreshNow();
  });
}

async function poll(): Promise<never> {
  let slowAt = performance.now();
  for (;;) {
    due = false;
    await ignoringFailures(async () => {
      if (!caller.value) return refreshSession();
      await refreshCell();
      await refreshScans();
      loaded.value = true;
      if (geometry.value === null) await loadGeometry();
      if (performance.now() - slowAt > SLOW_MS) {
        slowAt = performance.now();
        await refreshCalibration();
        await refreshSession();
      }
    });
    if (!due) await pause(atWork.value || running.value !== null ? BUSY_MS : IDLE_MS);
  }
}

/** Wait; `refreshNow` ends the wait. */
function pause(milliseconds: number): Promise<void> {
  return new Promise((resolve) => {
    const timer = setTimeout(resolve, milliseconds);
    wake = () => {
      clearTimeout(timer);
      resolve();
    };
  });
}

/** Ignore expected failures: the age of the last answer shows them, and the work is repeated. */
async function ignoringFailures(work: () => Promise<void>): Promise<void> {
  try {
    await work();
  } catch (error) {
    if (error instanceof RefusedError && error.slug === "unauthorized") caller.value = null;
    else if (!(error instanceof NoAnswerError || error instanceof CancelledError || error instanceof RefusedError)) reportError(error);
  }
}

async function listen(): Promise<never> {
  let last: string | null = null;
  for (let failures = 0; ; ) {
    await until(following);
    const ended = new AbortController();
    const end = following.subscribe((active) => active || ended.abort());
    try {
      last = await readEvents("/api/events?arm=true", last, ended.signal, (message) => {
        failures = 0;
        live.value = true;
        void ignoringFailures(() => apply(message.event ?? "", message.data));
      });
    } catch (error) {
      // The service would always refuse an id that it does not know, such as one of another data folder.
      if (error instanceof Error && error.cause === 422) last = null;
    } finally {
      live.value = false;
      end();
    }
    await new Promise((resolve) => setTimeout(resolve, RETRY_MS[Math.min(failures++, RETRY_MS.length - 1)]));
  }
}

async function apply(event: string, data: string): Promise<void> {
  if (event === "cell") {
    cellEvent(JSON.parse(data));
    refreshNow(); // for what the event does not contain
  } else if (event === "arm") armEvent.value = JSON.parse(data);
  else if (event === "resync") await refreshScans();
  else await scanEvent(JSON.parse(data) as ScanEvent);
}

/** Wait until a condition is true. */
export function until(condition: ReadonlySignal<boolean>): Promise<void> {
  return new Promise((resolve) => {
    const end = condition.subscribe((met) => {
      if (!met) return;
      queueMicrotask(() => end());
      resolve();
    });
  });
}
