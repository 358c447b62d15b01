import { useEffect, useState } from "preact/hooks";
import type { Method, Scan } from "../net/api";
import { addressOf } from "../route";
import { parseRadius, RadiusField, radiusMetres, radiusText } from "../scan/radius_field";
import { calibrating } from "../state/cell";
import { recogniseAgain } from "../state/recognise_again";
import { latest, running } from "../state/scans";
import { problemDetail } from "../texts/problem";
import { hasModel, isActive, outcome } from "../texts/states";
import { t } from "../texts/translate";
import { Act, Failed, useAction } from "../ui/action";
import { WhatToDo } from "../ui/manual";
import { MethodField } from "../ui/method_field";

/** Recognises the recording of a scan again, as a new scan. Nothing moves. */
export function Reprocess({ scan }: { scan: Scan }) {
  const [method, setMethod] = useState<Method>(scan.method);
  const [text, setText] = useState(scan.summary?.chains === 0 ? "" : radiusText(scan.string_radius_m));
  const [started, setStarted] = useState<Scan | null>(null);
  const action = useAction();
  const radius = parseRadius(text);

  async function start(): Promise<void> {
    setStarted(await recogniseAgain(scan, { method, string_radius_m: radiusMetres(radius) }));
  }

  // The page follows only the newest scan, so the last known state of this one is kept here.
  const newest = started !== null && latest.value?.id === started.id ? latest.value : null;
  useEffect(() => {
    if (newest !== null) setStarted(newest);
  }, [newest]);
  const created = newest ?? (started !== null && !isActive(started.state) ? started : null);
  return (
    <fieldset class="again">
      <legend>{t("history.reprocess.title")}</legend>
      <div class="row">
        <MethodField method={method} choose={setMethod} />
        <RadiusField number={radius} write={setText} empty={t("scan.start.measure")} />
        <Act
          action={action}
          work={start}
          doing={t("common.starting")}
          disabled={radius.fault !== null || running.value !== null || calibrating.value}
        >
          {t("history.reprocess.button")}
        </Act>
      </div>
      {calibrating.value && <p class="note warn">{t("scan.start.calibrating")}</p>}
      <Failed failure={action.failure} />
      {created !== null && (
        <p role="status">
          {t("history.reprocess.state", { state: outcome(created).word })}{" "}
          {created.problem && problemDetail(created.problem)}{" "}
          <WhatToDo problem={created.problem?.type ?? null} />
          {hasModel(created) && <a href={addressOf("result", created.id)}>{t("history.reprocess.result")}</a>}
        </p>
      )}
    </fieldset>
  );
}
