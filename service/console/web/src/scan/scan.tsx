import { useEffect, useState } from "preact/hooks";
import { CellView } from "../cell_view/cell_view";
import type { Model, Scan } from "../net/api";
import { loadModel } from "../result/data/use_result";
import { cell } from "../state/cell";
import { followed, latestOriginal, running } from "../state/scans";
import { callerNames, canOperate } from "../state/session";
import { hasModel } from "../texts/states";
import { t } from "../texts/translate";
import { Failed, useAction } from "../ui/action";
import { useQuery } from "../ui/use_query";
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
  const drawn = drawnScan();
  const model = useModel(drawn);
  const listed = running.value ?? scan;
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
        {running.value === null && scan !== null && scan.id === followed.value && <LastScan scan={scan} />}
        {/* Only hidden, so that the form keeps its content for the next scan. */}
        <div hidden={running.value !== null}>{canOperate.value && <Start action={action} />}</div>
        {running.value === null && scan !== null && scan.id !== followed.value && <LastScan scan={scan} />}
      </div>
      <CellView scan={drawn} checked={checkedPlan.value} model={model} />
      {listed?.mode === "live" && <Views scan={listed} planned={plannedViews(listed)} />}
    </div>
  );
}

/** Return the live scan that runs, or the last one, if it ran while this page was open; null: none. */
function drawnScan(): Scan | null {
  const { value } = running;
  if (value?.mode === "live" && value.source === null) return value;
  const last = latestOriginal.value;
  return last !== null && last.id === followed.value ? last : null;
}

/** Return the viewpoints of the cell's plan that the arm has not reached yet. */
function plannedViews(scan: Scan): number[] {
  const plan = cell.value?.viewpoints;
  if (!plan || !["preflight", "scanning"].includes(scan.state)) return [];
  const known = new Set([...scan.progress.views, ...plan.unreachable].map((view) => view.index));
  return Array.from({ length: plan.planned }, (_, index) => index).filter((index) => !known.has(index));
}

/** Load the model of a scan as soon as it has one. */
function useModel(scan: Scan | null): Model | null {
  const [loaded, setLoaded] = useState<{ id: string; model: Model } | null>(null);
  const id = scan !== null && hasModel(scan) ? scan.id : null;
  useQuery(
    async () => (id === null ? null : (await loadModel(id)).model),
    (model) => setLoaded(id === null || model === null ? null : { id, model }),
    [id],
  );
  return loaded !== null && loaded.id === id ? loaded.model : null;
}
