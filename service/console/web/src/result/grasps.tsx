import type { Model } from "../net/api";
import { mm } from "../texts/format";
import { t } from "../texts/translate";
import { Hint } from "../ui/hint";
import { BEST_GRASPS, type Grasp, type Target } from "../view3d/scene";

/** Recognition measures clearances only up to this distance. */
const MAX_CLEARANCE_M = 0.03;

/** The best grasps. */
export function Grasps({ model, show }: { model: Model; show: (target: Target) => void }) {
  const total = model.grasps.length;
  return (
    <section>
      <h2>
        <Hint term="grasp">
          {total > BEST_GRASPS ? t("result.grasps.best", { shown: BEST_GRASPS, total }) : t("result.grasps.title")}
        </Hint>
      </h2>
      {total === 0 && <p>{t("result.grasps.none")}</p>}
      <ul class="targets">
        {model.grasps.slice(0, BEST_GRASPS).map((grasp, index) => (
          <li key={index}>
            <button type="button" onClick={() => show({ kind: "grasp", index })}>
              {graspText(grasp, index)}
            </button>
          </li>
        ))}
      </ul>
    </section>
  );
}

function graspText({ chain, s_m, opening_m, clearance_m }: Grasp, index: number): string {
  const values = {
    index,
    string: chain,
    at: mm(s_m, 0),
    opening: mm(opening_m, 0),
    clearance: mm(clearance_m, 0),
  };
  return clearance_m >= MAX_CLEARANCE_M ? t("result.grasps.text_far", values) : t("result.grasps.text", values);
}
