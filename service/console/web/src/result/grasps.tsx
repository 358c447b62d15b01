import type { Model, Scan } from "../net/api";
import { mm } from "../texts/format";
import { t } from "../texts/translate";
import { Act, Failed } from "../ui/action";
import { Hint } from "../ui/hint";
import type { Grasp, Target } from "../view3d/scene";
import type { Selection } from "../viewer/viewer";
import { MAX_CLEARANCE_M, SelectedGrasp } from "./selected_grasp";
import { Trust, TRUST_CLASSES } from "./trust";
import type { Reach } from "./data/use_reach";

interface GraspsProps {
  scan: Scan;
  model: Model;
  /** The grasps to list. */
  listed: readonly Grasp[];
  reach: Reach;
  selection: Selection | null;
  select: (selection: Selection | null) => void;
  /** Selects a target, and turns the view to it. */
  show: (target: Target) => void;
}

/**
 * The best grasps, those that the arm reaches first. A press on one selects it and shows its details; another press
 * deselects it.
 */
export function Grasps({ scan, model, listed, reach, selection, select, show }: GraspsProps) {
  const total = model.grasps.length;
  const selected = selection?.target.kind === "grasp" ? selection.target.id : null;
  return (
    <section>
      <h2>
        <Hint term="grasp">
          {total > listed.length ? t("result.grasps.best", { shown: listed.length, total }) : t("result.grasps.title")}
        </Hint>
      </h2>
      {total === 0 && <p>{hasUntrusted(model) ? t("result.grasps.none_trusted") : t("result.grasps.none")}</p>}
      <ReachOfAll model={model} reach={reach} />
      <ul class="targets">
        {listed.map((grasp) => (
          <li key={grasp.id}>
            <button
              type="button"
              class={TRUST_CLASSES[grasp.trusted ? "accept" : "review"]}
              aria-pressed={grasp.id === selected}
              disabled={reach.grasps === null && reach.failure === null} // the order may still change
              onClick={() => (grasp.id === selected ? select(null) : show({ kind: "grasp", id: grasp.id }))}
            >
              {graspText(grasp)}{" "}
              {!grasp.trusted && <Trust verdict="review">{t("result.trust.review")}</Trust>}
              {reach.grasps?.get(grasp.id)?.reach?.reachable === false && (
                <Trust verdict="review">{t("result.grasps.not_reachable")}</Trust>
              )}
            </button>
            {grasp.id === selected && (
              <SelectedGrasp
                scan={scan}
                grasp={grasp}
                chain={model.chains.find(({ id }) => id === grasp.chain)}
                reach={reach}
                picked={selection?.turn === false}
              />
            )}
          </li>
        ))}
      </ul>
    </section>
  );
}

/** How many grasps the arm reaches, or a button to check it where that is not known. */
function ReachOfAll({ model, reach: { grasps, sameGripper, check, checking } }: { model: Model; reach: Reach }) {
  const total = model.grasps.length;
  if (grasps === null || grasps.size === 0) return null;
  const known = [...grasps.values()].flatMap(({ reach }) => (reach === null ? [] : [reach]));
  const reachable = known.filter((reach) => reach.reachable).length;
  if (known.length > 0) {
    if (reachable === 0) return <p class="note warn">{t("result.grasps.reach_none", { total })}</p>;
    if (reachable === total) return <p>{t("result.grasps.reach_all")}</p>;
    return <p>{t("result.grasps.reach_some", { reachable, total })}</p>;
  }
  if (sameGripper === false) return <p class="note warn">{t("result.grasps.other_gripper")}</p>;
  return (
    <>
      <p>{t("result.grasps.reach_unknown")}</p>
      <p>
        <Act action={checking} work={check} doing={t("result.grasps.reach_checking")}>
          {t("result.grasps.reach_check")}
        </Act>
      </p>
      <Failed failure={checking.failure} />
    </>
  );
}

/** Return whether grasps were excluded because of doubts. */
function hasUntrusted({ quality }: Model): boolean {
  return quality.findings.some(({ code }) => code === "no-trusted-grasp");
}

function graspText({ id, chain, s_m, opening_m, clearance_m }: Grasp): string {
  const values = {
    index: id,
    string: chain,
    at: mm(s_m, 0),
    opening: mm(opening_m, 0),
    clearance: mm(clearance_m, 0),
  };
  return clearance_m >= MAX_CLEARANCE_M ? t("result.grasps.text_far", values) : t("result.grasps.text", values);
}
