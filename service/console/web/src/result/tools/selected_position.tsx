import type { Model, Scan } from "../../net/api";
import { mm, plusMinus, pointText } from "../../texts/format";
import { t } from "../../texts/translate";
import { HintedEntry } from "../../ui/hint";
import type { Target } from "../../view3d/scene";
import type { Selection } from "../../viewer/viewer";
import { Copy } from "./copy";
import { type Position, positionOf } from "./position";

/** The buttons that step along a string: name, number of points, sign. */
const STEPS = [
  ["far_before", -10, "◀◀"],
  ["before", -1, "◀"],
  ["next", 1, "▶"],
  ["far_next", 10, "▶▶"],
] as const;

interface SelectedPositionProps {
  scan: Scan;
  model: Model;
  target: Target;
  select: (selection: Selection | null) => void;
  /** Starts a measurement at the selected position. */
  measureFrom: (position: Position) => void;
}

/** The selected point of a string, crossing or measured point. */
export function SelectedPosition({ scan, model, target, select, measureFrom }: SelectedPositionProps) {
  const position = positionOf(target, model);
  if (position === null) return target.kind === "chain" ? <EndButtons id={target.id} model={model} select={select} /> : null;
  const { on, sigma_m } = position;
  const step = (by: number) => {
    if (on === null) return;
    const { chain, index } = on;
    const count = chain.points.length;
    const next = chain.closed ? (index + by + count) % count : Math.min(count - 1, Math.max(0, index + by));
    select({ target: { kind: "point", chain: chain.id, s_m: chain.arc_length_m[next] ?? 0 }, turn: false });
  };
  return (
    <section class="panel point" aria-label={t("result.point.region")}>
      <h2>{position.name}</h2>
      <dl>
        <dt>{t("result.point.position")}</dt>
        <dd>{pointText(position.point)}</dd>
        {on !== null && (
          <>
            <dt>{t("result.point.arc_length")}</dt>
            <dd>{t("result.point.arc_length_of", { at: mm(on.s_m), length: mm(on.chain.length_m) })}</dd>
          </>
        )}
        {sigma_m !== null && (
          <HintedEntry term="sigma" name={t("result.point.sigma")}>
            {plusMinus(sigma_m)}
          </HintedEntry>
        )}
        {on !== null && (
          <>
            <dt>{t("result.point.observed_by")}</dt>
            <dd>{observedText(on.chain.views[on.index] ?? 0)}</dd>
          </>
        )}
      </dl>
      <div class="row">
        {on !== null && (
          <>
            {STEPS.map(([name, by, sign]) => (
              <button key={name} type="button" onClick={() => step(by)} aria-label={t(`result.point.${name}`)}>
                {sign}
              </button>
            ))}
          </>
        )}
        <button type="button" onClick={() => measureFrom(position)}>
          {t("result.measure.start")}
        </button>
        <Copy value={copyOf(scan, target, position, model)} point={position.point} />
        <button type="button" onClick={() => select(null)}>
          {t("result.point.deselect")}
        </button>
      </div>
    </section>
  );
}

type EndButtonsProps = Pick<SelectedPositionProps, "model" | "select"> & { id: number };

/** Selects an end of the selected string, to step from there. */
function EndButtons({ id, model, select }: EndButtonsProps) {
  const chain = model.chains.find((one) => one.id === id);
  if (chain === undefined) return null;
  const point = (s_m: number) => () => select({ target: { kind: "point", chain: id, s_m }, turn: false });
  return (
    <section class="panel point" aria-label={t("result.point.string_region")}>
      <h2>{t("result.point.string", { id })}</h2>
      <div class="row">
        <button type="button" onClick={point(0)}>
          {t("result.point.first")}
        </button>
        <button type="button" onClick={point(chain.arc_length_m.at(-1) ?? 0)}>
          {t("result.point.last")}
        </button>
      </div>
    </section>
  );
}

function observedText(views: number): string {
  return views === 0 ? t("result.point.bridged") : t("units.views", { count: views });
}

/** Return what is copied of a position. */
function copyOf(scan: Scan, target: Target, { point, sigma_m, on }: Position, { crossings }: Model): object {
  const copy = { scan: scan.id, frame: "base", point_m: point, sigma_m };
  if (on !== null) return { ...copy, chain: on.chain.id, index: on.index, s_m: on.s_m };
  const crossing = target.kind === "crossing" ? crossings.find(({ id }) => id === target.id) : undefined;
  if (crossing === undefined) return copy;
  const { id, over, under, gap_m, angle_rad } = crossing;
  return { ...copy, crossing: id, over, under, gap_m, angle_rad };
}
