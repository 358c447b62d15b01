import { useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import { CellView } from "../cell_view/cell_view";
import type { Scan } from "../net/api";
import { loadModel } from "../result/data/use_result";
import { cell } from "../state/cell";
import { followed, latestOriginal, running } from "../state/scans";
import { callerNames, canOperate } from "../state/session";
import { hasModel, isActive } from "../texts/states";
import { t } from "../texts/translate";
import { Failed, useAction } from "../ui/action";
import { useLoaded } from "../ui/use_loaded";
import { checkedPlan } from "./form_state";
import { LastScan } from "./last_scan";
import { Progress } from "./progress";
import { Start } from "./start";
import { Views } from "./views";

/** The screen that starts a scan and shows the cell, its progress and its outcome. */
export function ScanScreen() {
  const scan = latestOriginal.value;
  const action = useAction();
  const runningId = running.value?.id;
  useEffect(() => scrollTo(0, 0), [runningId]); // a scan that starts or ends is shown at the top
  const settling = useSettling(running.value !== null);
  const drawn = drawnScan();
  const model = useLoaded(drawn?.id ?? null, drawn !== null && hasModel(drawn), loadModel);
  const listed = running.value ?? scan;
  const last = running.value === null && scan !== null && <LastScan scan={scan} />;
  const isNew = scan?.id === followed.value;
  return (
    <div class="scan">
      <h1 class="unseen">{t("scan.title")}</h1>
      <div class="controls">
        {!canOperate.value && <p class="note">{t("scan.not_allowed", callerNames())}</p>}
        {running.value !== null && (
          <>
            <Failed failure={action.failure} />
            <Progress scan={running.value} />
          </>
        )}
        {isNew && last}
        {/* Only hidden, so that the form keeps its content for the next scan. */}
        <div hidden={running.value !== null}>{canOperate.value && <Start action={action} settling={settling} />}</div>
        {!isNew && last}
      </div>
      <CellView scan={drawn} checked={checkedPlan.value} model={model} />
      {listed?.mode === "live" && <Views scan={listed} planned={plannedViews(listed)} />}
    </div>
  );
}

/** The form returns where something else was: a press within this time was meant for that. */
const SETTLING_MS = 2000;

/** Return whether a scan has ended just now. */
function useSettling(runs: boolean): boolean {
  const ran = useRef(runs);
  const [settling, setSettling] = useState(false);
  useLayoutEffect(() => {
    const ended = ran.current && !runs;
    ran.current = runs;
    setSettling(ended);
    if (!ended) return;
    const timer = setTimeout(() => setSettling(false), SETTLING_MS);
    return () => clearTimeout(timer);
  }, [runs]);
  return settling;
}

/** Return the live scan that runs, or the last one, if it ran while this page was open; null: none. */
function drawnScan(): Scan | null {
  const { value } = running;
  if (value?.mode === "live") return value;
  const last = latestOriginal.value;
  return last !== null && last.id === followed.value ? last : null;
}

/** Return the viewpoints that the arm has not reached, or did not reach before the scan ended. */
function plannedViews({ views, progress, state }: Scan): number[] {
  if (views === "auto" && !isActive(state)) return []; // the others were not needed
  const count = typeof views === "number" ? views : (cell.value?.viewpoints?.planned ?? 0);
  const known = new Set(progress.views.map((view) => view.index));
  return Array.from({ length: count }, (_, index) => index).filter((index) => !known.has(index));
}
