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

const AGAIN_MS = 1000;
const SHOWN = 20;

/** Where the camera sits on the arm: how sure that is, and measuring it anew. */
export function CalibrationScreen() {
  const [runs, setRuns] = useState<Run[] | null>(null);
  const [failure, setFailure] = useState<Failure | null>(null);

  async function ask(): Promise<void> {
    setRuns((await told(api.GET("/api/calibration/runs", { params: { query: { limit: SHOWN } } }))).runs);
  }

  const [latest, ...earlier] = runs ?? [];
  const active = latest !== undefined && underWay(latest.state);
  // One that somebody else has begun makes the cell busy.
  const state = cell.value?.state;
  useEffect(() => {
    let open = true;
    let timer: ReturnType<typeof setTimeout> | undefined;
    const again = async () => {
      try {
        await ask();
        setFailure(null);
      } catch (error) {
        setFailure(failureOf(error));
      }
      if (open && active) timer = setTimeout(again, AGAIN_MS);
    };
    void again();
    if (!active) void askCalibration().catch(failureOf);
    return () => {
      open = false;
      clearTimeout(timer);
    };
  }, [active, state]);

  const changed = (run: Run) => setRuns([run, ...(runs ?? []).filter((one) => one.id !== run.id)]);
  return (
    <div class="calibration">
      <h1>Calibration</h1>
      {active && latest !== undefined && <RunPanel run={latest} changed={changed} />}
      <InUse />
      {!active && latest !== undefined && <RunPanel run={latest} changed={changed} />}
      {!active && maintains.value && <StartRun started={changed} />}
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
