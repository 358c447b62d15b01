import "./scan.css";
import { latest, running } from "../state/scans";
import { caller, operates } from "../state/session";
import { Ended } from "./ended";
import { Progress } from "./progress";
import { Start } from "./start";

/** Starts a scan, and shows how it goes. */
export function ScanScreen() {
  const scan = latest.value;
  return (
    <div class="scan">
      <h1>Scan</h1>
      {running.value !== null && <Progress scan={running.value} />}
      {running.value === null && scan !== null && <Ended scan={scan} />}
      {operates.value ? (
        running.value === null && <Start />
      ) : (
        <p class="note">
          {caller.value?.name} is signed in as {caller.value?.role}: scans are started by operators. You see how they go, and
          can stop the arm at any time.
        </p>
      )}
    </div>
  );
}
