import "./scan.css";
import { useEffect } from "preact/hooks";
import { first, running } from "../state/scans";
import { caller, operates } from "../state/session";
import { Failed, useAction } from "../ui/action";
import { Ended } from "./ended";
import { Progress } from "./progress";
import { Start } from "./start";

/** Starts a scan, and shows how it goes. */
export function ScanScreen() {
  const scan = first.value;
  const action = useAction();
  const under = running.value?.id;
  useEffect(() => scrollTo(0, 0), [under]); // what has begun or ended is at the top
  return (
    <div class="scan">
      <h1>Scan</h1>
      {!operates.value && (
        <p class="note">
          {caller.value?.name} is signed in as {caller.value?.role}: scans are started by operators. You see how they go, and
          can stop the arm at any time.
        </p>
      )}
      {running.value !== null && (
        <>
          <Failed failure={action.failure} />
          <Progress scan={running.value} />
        </>
      )}
      {/* Only hidden, so that what was filled in is there for the next scan. */}
      <div class="columns" hidden={running.value !== null}>
        {operates.value && <Start action={action} />}
        {running.value === null && scan !== null && <Ended scan={scan} />}
      </div>
    </div>
  );
}
