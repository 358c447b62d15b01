import { useEffect, useState } from "preact/hooks";
import { api, slowly, told, type Method, type Scan } from "../net/api";
import { addressOf } from "../route";
import { radiusOf, RadiusField, radiusText, readRadius } from "../scan/radius";
import { calibrates } from "../state/cell";
import { askNow } from "../state/follow";
import { latest, running, show } from "../state/scans";
import { Act, Failed, useAction } from "../ui/action";
import { WhatToDo } from "../ui/manual";
import { MethodField } from "../ui/method_field";
import { sentence } from "../words/sentence";
import { CALIBRATES, hasModel, outcome, underWay } from "../words/states";

/** Works out what a scan saw once more, as a scan of its own. Nothing moves. */
export function Again({ scan }: { scan: Scan }) {
  const [method, setMethod] = useState<Method>(scan.method);
  const [text, setText] = useState(radiusText(scan.string_radius_m));
  const [begun, setBegun] = useState<Scan | null>(null);
  const action = useAction();
  const radius = readRadius(text);

  async function start(): Promise<void> {
    const body = { method, string_radius_m: radiusOf(radius) };
    const made = await told(api.POST("/api/scans/{id}/reprocess", { params: { path: { id: scan.id } }, body, ...slowly }));
    setBegun(made);
    show(made);
    askNow();
  }

  // The page follows the newest scan only: what it told last of this one is remembered.
  const newest = begun !== null && latest.value?.id === begun.id ? latest.value : null;
  useEffect(() => {
    if (newest !== null) setBegun(newest);
  }, [newest]);
  const made = newest ?? (begun !== null && !underWay(begun.state) ? begun : null);
  return (
    <fieldset class="again">
      <legend>Work it out again: nothing moves</legend>
      <div class="row">
        <MethodField method={method} choose={setMethod} />
        <RadiusField reading={radius} write={setText} empty="measure it" />
        <Act
          action={action}
          work={start}
          doing="Beginning ..."
          disabled={radius.fault !== null || running.value !== null || calibrates.value}
        >
          Work it out again
        </Act>
      </div>
      {calibrates.value && <p class="note warn">{CALIBRATES}</p>}
      <Failed failure={action.failure} />
      {made !== null && (
        <p role="status">
          {outcome(made).word}. {made.problem && sentence(made.problem.detail)}{" "}
          <WhatToDo problem={made.problem?.type ?? null} />
          {hasModel(made) && <a href={addressOf("result", made.id)}>Look at what came of it</a>}
        </p>
      )}
    </fieldset>
  );
}
