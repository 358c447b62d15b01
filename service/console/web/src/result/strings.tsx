import type { Model } from "../net/api";
import { mm } from "../texts/format";
import { t } from "../texts/translate";
import type { Chain, Target } from "../view3d/scene";
import { Trust, TRUST_CLASSES } from "./trust";

interface ListProps {
  model: Model;
  /** Turns the view to a target. */
  show: (target: Target) => void;
}

/** Length, thickness, ends and trust of each string. */
export function Strings({ model, show }: ListProps) {
  return (
    <section>
      <h2>{t("result.strings.title")}</h2>
      <ul class="targets">
        {model.chains.map((chain) => (
          <li key={chain.id}>
            <button
              type="button"
              class={TRUST_CLASSES[chain.trust]}
              onClick={() => show({ kind: "chain", id: chain.id })}
            >
              {stringText(chain)} <Trust verdict={chain.trust}>{trustText(chain)}</Trust>
            </button>
          </li>
        ))}
      </ul>
    </section>
  );
}

function stringText({ id, length_m, radius_m, closed, ends }: Chain): string {
  const values = { id, length: mm(length_m, 0), thickness: mm(2 * radius_m) };
  if (closed) return t("result.strings.closed", values);
  const [first, last] = [t(`result.strings.end.${ends[0]}`), t(`result.strings.end.${ends[1]}`)];
  return t("result.strings.open", { ...values, first, last });
}

function trustText({ trust, trusted_m, length_m }: Chain): string {
  if (trust !== "review") return t(`result.trust.${trust}`);
  const trusted = trusted_m.reduce((sum, [from, to]) => sum + to - from, 0);
  return t("result.strings.trusted", { trusted: mm(trusted, 0), length: mm(length_m, 0) });
}
