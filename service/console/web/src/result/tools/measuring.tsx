import type { Scan } from "../../net/api";
import { mm, plusMinus } from "../../texts/format";
import { t } from "../../texts/translate";
import { Copy } from "./copy";
import { measure, type Measurement, type Position } from "./position";

interface MeasuringProps {
  scan: Scan;
  from: Position;
  /** Null: it is not selected yet. */
  to: Position | null;
  end: () => void;
}

/** The distance from a position to the one that is selected next. */
export function Measuring({ scan, from, to, end }: MeasuringProps) {
  const result = to && measure(from, to);
  return (
    <section class="panel point" aria-label={t("result.measure.region")}>
      <h2>{t("result.measure.title")}</h2>
      <div aria-live="polite">
        {to === null || result === null ? (
          <p>{t("result.measure.select", { from: from.name })}</p>
        ) : (
          <>
            <p>{t("result.measure.between", { from: from.name, to: to.name })}</p>
            <Numbers result={result} />
          </>
        )}
      </div>
      <div class="row">
        {to !== null && result !== null && <Copy value={copyOf(scan, from, to, result)} />}
        <button type="button" onClick={end}>
          {t("result.measure.end")}
        </button>
      </div>
    </section>
  );
}

function Numbers({ result: { distance_m, difference_m, sigma_m, along_m } }: { result: Measurement }) {
  const [x, y, z] = difference_m;
  const [near, far] = along_m;
  return (
    <dl>
      <dt>{t("result.measure.straight")}</dt>
      <dd>
        <strong>{mm(distance_m)}</strong> {sigma_m === null ? "" : plusMinus(sigma_m)}
      </dd>
      <dt>{t("result.measure.difference")}</dt>
      <dd>{t("result.measure.axes", { x: mm(x), y: mm(y), z: mm(z) })}</dd>
      {near !== undefined && (
        <>
          <dt>{t("result.measure.along")}</dt>
          <dd>
            {far === undefined ? mm(near) : t("result.measure.along_ring", { near: mm(near), far: mm(far) })}
          </dd>
        </>
      )}
    </dl>
  );
}

/** Return what is copied of a measurement. */
function copyOf(scan: Scan, from: Position, to: Position, { along_m, ...measured }: Measurement): object {
  return { scan: scan.id, frame: "base", from_m: from.point, to_m: to.point, ...measured, along_m };
}
