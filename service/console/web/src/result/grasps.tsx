import type { Model, Scan } from "../net/api";
import { mm } from "../texts/format";
import { t } from "../texts/translate";
import { Hint } from "../ui/hint";
import { type Grasp, listedGrasps, type Target } from "../view3d/scene";
import type { Selection } from "../viewer/viewer";
import { MAX_CLEARANCE_M, SelectedGrasp } from "./selected_grasp";
import { Trust, TRUST_CLASSES } from "./trust";
import { useReach } from "./use_reach";

interface GraspsProps {
  scan: Scan;
  model: Model;
  selection: Selection | null;
  select: (selection: Selection | null) => void;
  /** Selects a target, and turns the view to it. */
  show: (target: Target) => void;
}

/** The best grasps. A press on one selects it and shows its details; another press deselects it. */
export function Grasps({ scan, model, selection, select, show }: GraspsProps) {
  const total = model.grasps.length;
  const listed = listedGrasps(model);
  const reach = useReach(scan.id, model);
  const selected = selection?.target.kind === "grasp" ? selection.target.id : null;
  return (
    <section>
      <h2>
        <Hint term="grasp">
          {total > listed.length ? t("result.grasps.best", { shown: listed.length, total }) : t("result.grasps.title")}
        </Hint>
      </h2>
      {total === 0 && <p>{hasUntrusted(model) ? t("result.grasps.none_trusted") : t("result.grasps.none")}</p>}
      <ul class="targets">
        {listed.map((grasp) => (
          <li key={grasp.id}>
            <button
              type="button"
              class={TRUST_CLASSES[grasp.trusted ? "accept" : "review"]}
              aria-pressed={grasp.id === selected}
              onClick={() => (grasp.id === selected ? select(null) : show({ kind: "grasp", id: grasp.id }))}
            >
              {graspText(grasp)}{" "}
              {!grasp.trusted && <Trust verdict="review">{t("result.trust.review")}</Trust>}
              {reach.grasps?.get(grasp.id)?.reachable === false && (
                <Trust verdict="review">{t("result.grasps.not_reachable")}</Trust>
              )}
            </button>
            {grasp.id === selected && (
              <SelectedGrasp
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
