import type { Model } from "../net/api";
import { mm } from "../texts/format";
import { t } from "../texts/translate";
import { Hint } from "../ui/hint";
import { BEST_GRASPS, type Grasp, type Target } from "../view3d/scene";
import { Trust, TRUST_CLASSES } from "./trust";

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
      {total === 0 && <p>{hasUntrusted(model) ? t("result.grasps.none_trusted") : t("result.grasps.none")}</p>}
      <ul class="targets">
        {model.grasps.slice(0, BEST_GRASPS).map((grasp, index) => (
          <li key={index}>
            <button
              type="button"
              class={TRUST_CLASSES[grasp.trusted ? "accept" : "review"]}
              onClick={() => show({ kind: "grasp", index })}
            >
              {graspText(grasp, index)}{" "}
              {!grasp.trusted && <Trust verdict="review">{t("result.trust.review")}</Trust>}
            </button>
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
