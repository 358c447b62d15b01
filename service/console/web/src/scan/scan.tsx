import { useEffect } from "preact/hooks";
import { latestOriginal, running } from "../state/scans";
import { callerNames, canOperate } from "../state/session";
import { t } from "../texts/translate";
import { Failed, useAction } from "../ui/action";
import { LastScan } from "./last_scan";
import { Progress } from "./progress";
import { Start } from "./start";

/** The screen that starts a scan and shows its progress. */
export function ScanScreen() {
  const scan = latestOriginal.value;
  const action = useAction();
  const runningId = running.value?.id;
  useEffect(() => scrollTo(0, 0), [runningId]); // a scan that starts or ends is shown at the top
  return (
    <div class="scan">
      <h1>{t("scan.title")}</h1>
      {!canOperate.value && <p class="note">{t("scan.not_allowed", callerNames())}</p>}
      {running.value !== null && (
        <>
          <Failed failure={action.failure} />
          <Progress scan={running.value} />
        </>
      )}
      {/* Only hidden, so that the form keeps its content for the next scan. */}
      <div class="columns" hidden={running.value !== null}>
        {canOperate.value && <Start action={action} />}
        {running.value === null && scan !== null && <LastScan scan={scan} />}
      </div>
    </div>
  );
}
