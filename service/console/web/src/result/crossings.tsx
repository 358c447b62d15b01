import type { Model } from "../net/api";
import { degrees, mm, percent } from "../texts/format";
import { rich, t } from "../texts/translate";
import { strong } from "../ui/action";
import { Hint } from "../ui/hint";
import { type Crossing, isUncertain, type Target } from "../view3d/scene";
import { Trust, TRUST_CLASSES } from "./trust";

interface ListProps {
  model: Model;
  /** Turns the view to a target. */
  show: (target: Target) => void;
}

/** Which strand lies over which. */
export function Crossings({ model, show }: ListProps) {
  if (model.crossings.length === 0) return null;
  return (
    <section>
      <h2>
        <Hint term="crossing">{t("result.crossings.title")}</Hint>
      </h2>
      <ul class="targets">
        {model.crossings.map((crossing) => (
          <li key={crossing.id}>
            <button
              type="button"
              class={TRUST_CLASSES[crossing.trust]}
              onClick={() => show({ kind: "crossing", id: crossing.id })}
            >
              {rich("result.crossings.text", {
                id: crossing.id,
                over: crossing.over.chain,
                over_at: mm(crossing.over.s_m, 0),
                under: crossing.under.chain,
                under_at: mm(crossing.under.s_m, 0),
                gap: mm(crossing.gap_m),
                angle: degrees(crossing.angle_rad),
                confidence: confidenceText(crossing),
                strong,
              })}{" "}
              {crossing.trust !== "accept" && (
                <Trust verdict={crossing.trust}>{t(`result.trust.${crossing.trust}`)}</Trust>
              )}
            </button>
          </li>
        ))}
      </ul>
    </section>
  );
}

/** Describe the confidence; no measurement is fully certain. */
function confidenceText(crossing: Crossing): string {
  const confidence = percent(crossing.confidence);
  if (isUncertain(crossing)) return t("result.crossings.uncertain", { confidence });
  return crossing.confidence > 0.99 ? t("result.crossings.certain") : t("result.crossings.confidence", { confidence });
}
