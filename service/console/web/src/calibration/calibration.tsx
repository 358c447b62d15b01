import "./calibration.css";
import { useEffect, useState } from "preact/hooks";
import { api, told, type Run } from "../net/api";
import { askCalibration, cell } from "../state/cell";
import { caller, maintains } from "../state/session";
import { Failed, failureOf, type Failure } from "../ui/action";
import { underWay } from "../words/states";
import { InUse } from "./in_use";
import { PastRuns } from "./past";
import { RunPanel } from "./run";
import { StartRun } from "./start";

/** While a run is under way. */
const SOON_MS = 1000;
/** After an answer that did not come. */
const LATER_MS = 5000;
const SHOWN = 20;

/** Where the camera sits on the arm: how sure that is, and measuring it anew. */
export function CalibrationScreen() {
  const [runs, setRuns] = useState<readonly Run[] | null>(null);
  const [failure, setFailure] = useState<Failure | null>(null);
  const [latest, ...earlier] = runs ?? [];
  const [watched, watch] = useState<string | null>(null);
  const active = latest !== undefined && underWay(latest.state) ? latest.id : null;
  const state = cell.value?.state; // one that somebody else has begun makes the cell busy

  useEffect(() => {
    let open = true;
    let timer: ReturnType<typeof setTimeout> | undefined;
    const ask = async () => {
      let again_ms = active === null ? null : SOON_MS;
      try {
        if (active === null) {
          const query = { limit: SHOWN };
          const found = await told(api.GET("/api/calibration/runs", { params: { query } }));
          if (open) setRuns(found.runs);
          await askCalibration();
        } else {
          const run = await told(api.GET("/api/calibration/runs/{id}", { params: { path: { id: active } } }));
          if (open) setRuns((before) => withRun(before, run));
        }
        if (open) setFailure(null);
      } catch (error) {
        again_ms = again_ms ?? LATER_MS;
        if (open) setFailure(failureOf(error));
      }
      if (open && again_ms !== null) timer = setTimeout(ask, again_ms);
    };
    void ask();
    return () => {
      open = false;
      clearTimeout(timer);
    };
  }, [active, state]);

  // What has begun or ended is at the top, and in sight.
  useEffect(() => {
    if (active !== null) watch(active);
    scrollTo(0, 0);
  }, [active]);

  const changed = (run: Run) => setRuns((before) => withRun(before, run));
  const top = latest !== undefined && latest.id === watched ? latest : null;
  return (
    <div class="calibration">
      <h1>Calibration</h1>
      {top !== null && <RunPanel run={top} name={active === null ? "The last run" : "Under way"} changed={changed} />}
      {top !== null && active === null && <p class="note">Take the board off the table before the next scan.</p>}
      <InUse />
      {top === null && latest !== undefined && <RunPanel run={latest} name="The last run" changed={changed} />}
      {active === null && maintains.value && <StartRun started={changed} />}
      {!maintains.value && (
        <p class="note">
          {caller.value?.name} is signed in as {caller.value?.role}: calibrating and verifying is a maintainer's.
        </p>
      )}
      <Failed failure={failure} />
      <PastRuns runs={earlier} changed={changed} />
    </div>
  );
}

/** The runs with one of them as it is now; one that is new comes first. */
function withRun(runs: readonly Run[] | null, run: Run): readonly Run[] {
  const known = runs ?? [];
  if (known.some((one) => one.id === run.id)) return known.map((one) => (one.id === run.id ? run : one));
  return [run, ...known];
}
