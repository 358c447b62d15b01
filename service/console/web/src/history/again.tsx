import { useEffect, useState } from "preact/hooks";
import { api, slowly, told, type Method, type Scan } from "../net/api";
import { addressOf } from "../route";
import { askNow } from "../state/follow";
import { latest, running, show } from "../state/scans";
import { Act, Failed, sentence, useAction } from "../ui/action";
import { Field } from "../ui/field";
import { hasModel, METHODS, SCAN, underWay } from "../words/states";

/** Works out what a scan saw once more, as a scan of its own. Nothing moves. */
export function Again({ scan }: { scan: Scan }) {
  const [method, setMethod] = useState<Method>(scan.method);
  const [radius_mm, setRadius] = useState(scan.string_radius_m === null ? "" : String(+(scan.string_radius_m * 1000).toFixed(3)));
  const [begun, setBegun] = useState<Scan | null>(null);
  const action = useAction();

  async function start(): Promise<void> {
    const body = { method, string_radius_m: radius_mm === "" ? null : Number(radius_mm) / 1000 };
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
        <Field label="Method" hint="method">
          {(id) => (
            <select id={id} value={method} onChange={(event) => setMethod(event.currentTarget.value as Method)}>
              {Object.entries(METHODS).map(([value, { name }]) => (
                <option key={value} value={value}>
                  {name}
                </option>
              ))}
            </select>
          )}
        </Field>
        <Field label="String radius, in mm" hint="string radius">
          {(id) => (
            <input
              id={id}
              type="number"
              inputMode="decimal"
              step="any"
              min="0"
              value={radius_mm}
              placeholder="measure it"
              onInput={(event) => setRadius(event.currentTarget.value)}
            />
          )}
        </Field>
        <Act action={action} work={start} doing="Beginning ..." disabled={running.value !== null}>
          Work it out again
        </Act>
      </div>
      <Failed failure={action.failure} />
      {made !== null && (
        <p role="status">
          {SCAN[made.state].word}.{" "}
          {made.problem && sentence(made.problem.detail)}
          {hasModel(made) && <a href={addressOf("result", made.id)}>Look at what came of it</a>}
        </p>
      )}
    </fieldset>
  );
}
