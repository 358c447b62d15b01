import { useEffect, useState } from "preact/hooks";
import { api, resultOf, type Method, type Model, type Scan } from "../net/api";
import { recogniseAgain } from "../state/recognise_again";
import { changes, running } from "../state/scans";
import { canOperate } from "../state/session";
import { Act, Failed, useAction } from "../ui/action";
import { useQuery } from "../ui/use_query";
import { Hint } from "../ui/hint";
import { lineOf, type Other } from "../view3d/scene";
import { mm } from "../texts/format";
import { hasModel, METHODS } from "../texts/states";
import { t } from "../texts/translate";
import { loadModel } from "./data/use_result";

interface CompareProps {
  scan: Scan;
  model: Model;
  others: readonly Other[];
  setOthers: (others: readonly Other[]) => void;
}

/** The results of other methods from the same views, as numbers and as lines in the picture. */
export function Compare({ scan, model, others, setOthers }: CompareProps) {
  const [known, setKnown] = useState<readonly Scan[]>([]);
  const failure = useQuery(
    () => resultOf(api.GET("/api/scans", { params: { query: { recording: scan.recording ?? undefined } } })),
    ({ scans }) => setKnown(scans.filter(hasModel)),
    [changes.value],
  );
  if (!canOperate.value && known.every((one) => one.method === scan.method)) return failure && <Failed failure={failure} />;
  const methods = METHODS.filter((method) => method !== scan.method);
  return (
    <section class="compare">
      <h2>
        <Hint term="method">{t("result.compare.title")}</Hint>
      </h2>
      <table>
        <thead>
          <tr>
            <th scope="col">{t("field.method")}</th>
            <th scope="col">{t("result.strings.title")}</th>
            <th scope="col">{t("result.crossings.title")}</th>
            <th scope="col">{t("result.compare.length")}</th>
            <th scope="col">{t("result.compare.shown_as")}</th>
          </tr>
        </thead>
        <tbody>
          <Numbers name={t("result.compare.this", { method: t(`method.${scan.method}.name`) })} model={model} />
          {others.map(({ method, model: other }) => (
            <Numbers key={method} name={t(`method.${method}.name`)} model={other} line={lineOf(method)} />
          ))}
        </tbody>
      </table>
      <div class="row">
        {methods.map((method) => (
          <OtherMethod
            key={method}
            scan={scan}
            method={method}
            // Results with different radii cannot be compared.
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
  /** How its strings are drawn; undefined: as tubes. */
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
        {line && <span class="sample" style={{ background: line.colour }} />}{" "}
        {line ? t(`result.compare.line.${line.style}`) : t("result.compare.tubes")}
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
  const [requested, setRequested] = useState(false);
  const name = t(`method.${method}.name`);

  async function load(id: string): Promise<void> {
    add({ method, model: await loadModel(id) });
  }

  useEffect(() => {
    if (!requested || done === undefined) return;
    setRequested(false);
    void action.run(() => load(done.id));
  }, [requested, done?.id]);

  if (shown) {
    return (
      <button type="button" aria-pressed="true" onClick={remove}>
        {t("result.compare.hide", { method: name })}
      </button>
    );
  }
  if (done !== undefined) {
    return (
      <>
        <Act action={action} work={() => load(done.id)}>{t("result.compare.show", { method: name })}</Act>
        <Failed failure={action.failure} />
      </>
    );
  }
  if (!canOperate.value || scan.links.reprocess === null) return null;
  return (
    <>
      <Act
        action={action}
        disabled={running.value !== null}
        work={async () => {
          await recogniseAgain(scan, { method });
          setRequested(true);
        }}
      >
        {requested && running.value !== null
          ? t("result.compare.running", { method: name })
          : t("result.compare.run", { method: name })}
      </Act>
      <Failed failure={action.failure} />
    </>
  );
}
