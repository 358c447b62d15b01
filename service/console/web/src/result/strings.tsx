import type { Model } from "../net/api";
import { mm } from "../texts/format";
import { t } from "../texts/translate";
import type { Chain, Target } from "../view3d/scene";

interface ListProps {
  model: Model;
  /** Turns the view to a target. */
  show: (target: Target) => void;
}

/** Length, thickness and ends of each string. */
export function Strings({ model, show }: ListProps) {
  return (
    <section>
      <h2>{t("result.strings.title")}</h2>
      <ul class="targets">
        {model.chains.map((chain) => (
          <li key={chain.id}>
            <button type="button" onClick={() => show({ kind: "chain", id: chain.id })}>
              {stringText(chain)}
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
