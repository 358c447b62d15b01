import { useEffect, useState } from "preact/hooks";
import { api, slowly, told, type Method, type Model, type Scan } from "../net/api";
import { askNow } from "../state/follow";
import { changes, running, show } from "../state/scans";
import { operates } from "../state/session";
import { Act, Failed, useAction } from "../ui/action";
import { useAsked } from "../ui/asked";
import { Hint } from "../ui/hint";
import { lineOf, type Other } from "../view3d/scene";
import { hasModel, METHODS } from "../words/states";
import { mm } from "../words/units";
import { loadModel } from "./load";

interface CompareProps {
  scan: Scan;
  model: Model;
  others: readonly Other[];
  setOthers: (others: readonly Other[]) => void;
}

/** What the other methods make of the same views, in numbers and as lines in the picture. */
export function Compare({ scan, model, others, setOthers }: CompareProps) {
  const [known, setKnown] = useState<readonly Scan[]>([]);
  const failure = useAsked(
    () => told(api.GET("/api/scans", { params: { query: { recording: scan.recording ?? undefined } } })),
    ({ scans }) => setKnown(scans.filter(hasModel)),
    [changes.value],
  );
  if (!operates.value && known.every((one) => one.method === scan.method)) return failure && <Failed failure={failure} />;
  const methods = (Object.keys(METHODS) as Method[]).filter((method) => method !== scan.method);
  return (
    <section class="compare">
      <h2>
        <Hint term="method">Compare methods</Hint>
      </h2>
      <table>
        <thead>
          <tr>
            <th scope="col">Method</th>
            <th scope="col">Strings</th>
            <th scope="col">Crossings</th>
            <th scope="col">Length</th>
            <th scope="col">Shown as</th>
          </tr>
        </thead>
        <tbody>
          <Numbers name={`${scan.method} (this)`} model={model} />
          {others.map(({ method, model: other }) => (
            <Numbers key={method} name={method} model={other} line={lineOf(method)} />
          ))}
        </tbody>
      </table>
      <div class="row">
        {methods.map((method) => (
          <OtherMethod
            key={method}
            scan={scan}
            method={method}
            // Worked out with the same radius, or the two could not be compared.
            done={known.find((one) => one.method === method && one.string_radius_m === scan.string_radius_m)}
            shown={others.some((other) => other.method === method)}
            add={(other) => setOthers([...others.filter((one) => one.method !== method), other])}
            remove={() => setOthers(others.filter((one) => one.method !== method))}
          />
        ))}
      </div>
      <Failed failure={failure} />
    </section>
  );
}

interface NumbersProps {
  name: string;
  model: Model;
  /** How its strings are drawn; tubes if it is not told. */
  line?: ReturnType<typeof lineOf>;
}

function Numbers({ name, model, line }: NumbersProps) {
  return (
    <tr>
      <th scope="row">{name}</th>
      <td>{model.chains.length}</td>
      <td>{model.crossings.length}</td>
      <td>{mm(model.chains.reduce((sum, chain) => sum + chain.length_m, 0), 0)}</td>
      <td>
        {line && <span class="sample" style={{ background: line.colour }} />} {line ? `${line.style} line` : "tubes"}
      </td>
    </tr>
  );
}

interface OtherProps {
  scan: Scan;
  method: Method;
  done: Scan | undefined;
  shown: boolean;
  add: (other: Other) => void;
  remove: () => void;
}

function OtherMethod({ scan, method, done, shown, add, remove }: OtherProps) {
  const action = useAction();
  const [asked, setAsked] = useState(false);

  async function load(id: string): Promise<void> {
    add({ method, model: await loadModel(id) });
  }

  useEffect(() => {
    if (!asked || done === undefined) return;
    setAsked(false);
    void action.run(() => load(done.id));
  }, [asked, done?.id]);

  if (shown) {
    return (
      <button type="button" aria-pressed="true" onClick={remove}>
        {method}: hide
      </button>
    );
  }
  if (done !== undefined) {
    return (
      <>
        <Act action={action} work={() => load(done.id)}>{`${method}: show beside`}</Act>
        <Failed failure={action.failure} />
      </>
    );
  }
  if (!operates.value || scan.links.reprocess === null) return null;
  return (
    <>
      <Act
        action={action}
        disabled={running.value !== null}
        work={async () => {
          const params = { path: { id: scan.id } };
          show(await told(api.POST("/api/scans/{id}/reprocess", { params, body: { method }, ...slowly })));
          setAsked(true);
          askNow();
        }}
      >
        {asked && running.value !== null ? `${method}: working it out ...` : `${method}: work it out`}
      </Act>
      <Failed failure={action.failure} />
    </>
  );
}
