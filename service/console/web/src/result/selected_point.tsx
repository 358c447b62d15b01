import { useEffect, useRef } from "preact/hooks";
import type { Model } from "../net/api";
import { mm, plusMinus, pointText } from "../texts/format";
import { t } from "../texts/translate";
import { HintedEntry } from "../ui/hint";
import { pointAt } from "../view3d/arc_length";
import type { Target } from "../view3d/scene";
import type { Selection } from "../viewer/viewer";
import { revealBeside } from "./reveal";

interface SelectedPointProps {
  model: Model;
  target: Target;
  /** It was selected in the 3D view, so the page may have to scroll to the panel. */
  picked: boolean;
  select: (selection: Selection | null) => void;
}

/** The selected point of a string, with buttons to step along the string. */
export function SelectedPoint({ model, target, picked, select }: SelectedPointProps) {
  const section = useRef<HTMLElement>(null);
  useEffect(() => {
    if (picked && section.current !== null) revealBeside(section.current);
  }, [picked, target]);
  const chain = target.kind === "point" ? model.chains.find((one) => one.id === target.chain) : undefined;
  if (target.kind !== "point" || chain === undefined) return null;
  const { index } = pointAt(chain, target.s_m);
  const s_m = chain.arc_length_m[index] ?? 0;
  const views = chain.views[index] ?? 0;
  const step = (by: number) => {
    const count = chain.points.length;
    const next = chain.closed ? (index + by + count) % count : Math.min(count - 1, Math.max(0, index + by));
    select({ target: { kind: "point", chain: chain.id, s_m: chain.arc_length_m[next] ?? 0 }, turn: false });
  };
  return (
    <section ref={section} class="panel point" aria-label={t("result.point.region")}>
      <h2>{t("result.point.title", { string: chain.id, index })}</h2>
      <dl>
        <dt>{t("result.point.position")}</dt>
        <dd>{pointText(chain.points[index] ?? [])}</dd>
        <dt>{t("result.point.arc_length")}</dt>
        <dd>{t("result.point.arc_length_of", { at: mm(s_m), length: mm(chain.length_m) })}</dd>
        <HintedEntry term="sigma" name={t("result.point.sigma")}>
          {plusMinus(chain.sigma_m[index] ?? 0)}
        </HintedEntry>
        <dt>{t("result.point.observed_by")}</dt>
        <dd>{views === 0 ? t("result.point.bridged") : t("units.views", { count: views })}</dd>
      </dl>
      <div class="row">
        <button type="button" onClick={() => step(-1)} aria-label={t("result.point.before")}>
          ◀
        </button>
        <button type="button" onClick={() => step(1)} aria-label={t("result.point.next")}>
          ▶
        </button>
        <button type="button" onClick={() => select(null)}>
          {t("result.point.deselect")}
        </button>
      </div>
    </section>
  );
}
