import "./scan.css";
import { useEffect } from "preact/hooks";
import { latestOriginal, running } from "../state/scans";
import { caller, canOperate } from "../state/session";
import { findText, t } from "../texts/translate";
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

/** Return name and role of the caller, for people. */
export function callerNames(): { name: string; role: string } {
  const { name = "", role = "" } = caller.value ?? {};
  return { name, role: findText(`app.role_name.${role}`) ?? role };
}
