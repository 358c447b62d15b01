import { useState } from "preact/hooks";
import { Badge } from "../bar/status";
import { api, longCall, resultOf, type Scan } from "../net/api";
import { addressOf } from "../route";
import { mm, percent, when } from "../texts/format";
import { foundText, isElsewhere, outcome } from "../texts/states";
import { rich, t } from "../texts/translate";
import { Failed, useAction } from "../ui/action";
import { Field } from "../ui/field";
import { useQuery } from "../ui/use_query";
import { CERTAIN_CONFIDENCE, type ChainChange, EARLIER_LINE, type Model, type Pose, type Target } from "../view3d/scene";
import { earlierScans } from "./data/earlier_scans";
import { Trust } from "./trust";
import { loadModel } from "./data/use_result";

type Since = NonNullable<Model["since"]>;
type Match = Since["matches"][number];

/** An earlier scan, and the changes since it. */
export interface Earlier {
  scan: Scan;
  model: Model;
  since: Since;
}

interface ChangesProps {
  scan: Scan;
  earlier: Earlier | null;
  setEarlier: (earlier: Earlier | null) => void;
  /** Selects a target, and turns the view to it. */
  show: (target: Target) => void;
}

/** What has changed on the table since an earlier scan. */
export function Changes({ scan, earlier, setEarlier, show }: ChangesProps) {
  const [known, setKnown] = useState<readonly Scan[]>([]);
  const [chosen, setChosen] = useState("");
  const action = useAction();
  const failure = useQuery(() => earlierScans(scan), setKnown, [scan.id]);

  async function compare(id: string): Promise<void> {
    setEarlier(null);
    const before = known.find((one) => one.id === id);
    if (before === undefined) return;
    const params = { path: { id: scan.id }, query: { since: id } };
    const { since } = await resultOf(api.GET("/api/scans/{id}/model", { params, ...longCall }));
    if (since !== undefined) setEarlier({ scan: before, model: await loadModel(id), since: since as Since });
  }

  if (known.length === 0) return failure && <Failed failure={failure} />;
  return (
    <section aria-label={t("result.changes.title")}>
      <h2>{t("result.changes.title")}</h2>
      <Field label={t("result.changes.earlier")}>
        {(id) => (
          <select
            id={id}
            value={chosen}
            disabled={action.busy}
            onChange={({ currentTarget: { value } }) => {
              setChosen(value);
              void action.run(() => compare(value));
            }}
          >
            <option value="">{t("result.changes.none")}</option>
            {known.map((one) => (
              <option key={one.id} value={one.id}>
                {optionText(one)}
              </option>
            ))}
          </select>
        )}
      </Field>
      {isElsewhere(scan) && <p class="small">{t("result.changes.recordings")}</p>}
      <p role="status">{action.busy && t("common.loading")}</p>
      <Failed failure={action.failure} />
      {earlier !== null && <ChangeList earlier={earlier} show={show} />}
    </section>
  );
}

function optionText({ created_at, summary }: Scan): string {
  const found = foundText(summary?.chains ?? 0, summary?.crossings ?? 0);
  return t("result.changes.option", { when: when(created_at), found });
}

interface ChangeListProps {
  earlier: Earlier;
  show: (target: Target) => void;
}

/** The list of changes, the largest first. A press on one shows the string before and now. */
function ChangeList({ earlier: { scan, since }, show }: ChangeListProps) {
  const { word, tone } = outcome(scan);
  const link = (content: preact.ComponentChildren) => <a href={addressOf("result", scan.id)}>{content}</a>;
  const matches = [...since.matches].sort((a, b) => rank(b) - rank(a));
  const moved = matches.filter(({ change }) => change !== "unmoved");
  const unmoved = matches.filter(({ change }) => change === "unmoved");
  const entry = (change: ChainChange, text: string, confidence = 1) => (
    <li key={text}>
      <button type="button" onClick={() => show({ kind: "change", change })}>
        {text}{" "}
        {confidence < CERTAIN_CONFIDENCE && (
          <Trust verdict="review">{t("result.changes.uncertain", { confidence: percent(confidence) })}</Trust>
        )}
      </button>
    </li>
  );
  const ofMatch = (match: Match) => entry(changeOf(match), matchText(match), match.confidence);
  return (
    <>
      <p>
        <span class="sample" style={{ background: EARLIER_LINE.colour }} /> {rich("result.changes.drawn", { link })}{" "}
        <Badge tone={tone}>{word}</Badge>
      </p>
      <ul class="targets">
        {moved.map(ofMatch)}
        {since.new.map((id) => entry({ chain: id, before: null, T_now_before: null }, t("result.changes.new", { id })))}
        {since.gone.map((id) => entry({ chain: null, before: id, T_now_before: null }, t("result.changes.gone", { id })))}
        {unmoved.map(ofMatch)}
      </ul>
      <p class="small">{t("result.changes.missed")}</p>
    </>
  );
}

function rank({ change, displacement_m }: Match): number {
  return change === "unmoved" ? 0 : displacement_m;
}

function changeOf({ chain, before, change, T_now_before }: Match): ChainChange {
  return { chain, before, T_now_before: change === "unmoved" ? null : (T_now_before as Pose) };
}

function matchText({ chain: id, before, change, displacement_m }: Match): string {
  const text = t(`result.changes.${change}`, { id, distance: mm(displacement_m, 0) });
  return id === before ? text : t("result.changes.renumbered", { text, before });
}
