import { signal } from "@preact/signals";
import type { Method, Plan, Scan } from "../net/api";

export type Mode = Scan["mode"];

/** Content of the form for the next scan, kept as long as the page is open. */
export const form = {
  mode: signal<Mode>("live"),
  /** ID of the recording of a replay. */
  recording: signal<string | null>(null),
  method: signal<Method>("graph"),
  /** As entered, mm. */
  radius: signal(""),
  /** Number of viewpoints, as entered. */
  views: signal(""),
  /** Whether the scan takes as many views as needed, in place of that number; null: as configured. */
  quick: signal<boolean | null>(null),
};

/** What a scan with these settings would do, as last checked; null: not known yet. */
export const checkedPlan = signal<Plan | null>(null);
