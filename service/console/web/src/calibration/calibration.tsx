import { useEffect, useState } from "preact/hooks";
import { api, resultOf, type Run } from "../net/api";
import { refreshCalibration, cell } from "../state/cell";
import { callerNames, canMaintain } from "../state/session";
import { Failed, failureOf, type Failure } from "../ui/action";
import { isActive } from "../texts/states";
import { t } from "../texts/translate";
import { ActiveCalibration } from "./active_calibration";
import { PastRuns } from "./past_runs";
import { RunPanel } from "./run_panel";
import { StartRun } from "./start";

/** Interval while a run is active. */
const POLL_MS = 1000;
/** Pause after a request without an answer. */
const RETRY_MS = 5000;
const LISTED = 20;

/** The hand-eye calibration: its quality, its verification, and a new one. */
export function CalibrationScreen() {
  const [runs, setRuns] = useState<readonly Run[] | null>(null);
  const [failure, setFailure] = useState<Failure | null>(null);
  const [latest, ...earlier] = runs ?? [];
  const [watched, watch] = useState<string | null>(null);
  const active = latest !== undefined && isActive(latest.state) ? latest.id : null;
  const state = cell.value?.state; // a run that another caller started makes the cell busy

  useEffect(() => {
    let open = true;
    let timer: ReturnType<typeof setTimeout> | undefined;
    const poll = async () => {
      let pause_ms = active === null ? null : POLL_MS;
      try {
        if (active === null) {
          const query = { limit: LISTED };
          const found = await resultOf(api.GET("/api/calibration/runs", { params: { query } }));
          if (open) setRuns(found.runs);
          await refreshCalibration();
        } else {
          const run = await resultOf(api.GET("/api/calibration/runs/{id}", { params: { path: { id: active } } }));
          if (open) setRuns((before) => withRun(before, run));
        }
        if (open) setFailure(null);
      } catch (error) {
        pause_ms = pause_ms ?? RETRY_MS;
        if (open) setFailure(failureOf(error));
      }
      if (open && pause_ms !== null) timer = setTimeout(poll, pause_ms);
    };
    void poll();
    return () => {
      open = false;
      clearTimeout(timer);
    };
  }, [active, state]);

  // A run that starts or ends is shown at the top.
  useEffect(() => {
    if (active !== null) watch(active);
    scrollTo(0, 0);
  }, [active]);

  const changed = (run: Run) => setRuns((before) => withRun(before, run));
  const topName = active === null ? t("calibration.last_run") : t("calibration.running");
  const top = latest !== undefined && latest.id === watched ? latest : null;
  return (
    <div class="calibration">
      <h1>{t("calibration.title")}</h1>
      {top !== null && <RunPanel run={top} name={topName} changed={changed} />}
      {top !== null && active === null && <p class="note">{t("calibration.remove_board")}</p>}
      <ActiveCalibration />
      {top === null && latest !== undefined && <RunPanel run={latest} name={t("calibration.last_run")} changed={changed} />}
      {active === null && canMaintain.value && <StartRun started={changed} />}
      {!canMaintain.value && <p class="note">{t("calibration.not_allowed", callerNames())}</p>}
      <Failed failure={failure} />
      <PastRuns runs={earlier} changed={changed} />
    </div>
  );
}

/** Return the runs with one of them replaced; a new one comes first. */
function withRun(runs: readonly Run[] | null, run: Run): readonly Run[] {
  const known = runs ?? [];
  if (known.some((one) => one.id === run.id)) return known.map((one) => (one.id === run.id ? run : one));
  return [run, ...known];
}
