import { signal } from "@preact/signals";
import type { Method, Scan } from "../net/api";

export type Mode = Scan["mode"];

/** What the next scan is to be: kept while the page is open, whichever screen is shown. */
export const wanted = {
  mode: signal<Mode>("live"),
  /** Of a replay: which recording. */
  recording: signal<string | null>(null),
  method: signal<Method>("graph"),
  /** As written, in mm. */
  radius: signal(""),
  /** How many viewpoints, as written. */
  views: signal(""),
};
