import { mm } from "../texts/format";
import { rich, t } from "../texts/translate";
import { heightGradient, HIGHEST_M } from "../view3d/points/height_colours";
import type { HeightMap } from "../view3d/scene";

const TICKS = 4;

/** Which colour of the height map is which height above the table. */
export function HeightLegend({ map: { min_object_height_m: from_m } }: { map: HeightMap }) {
  const ticks = Array.from({ length: TICKS }, (_, k) => from_m + (k / (TICKS - 1)) * (HIGHEST_M - from_m));
  const scale = (
    <span class="scale">
      <span class="colours" style={{ background: heightGradient(from_m) }} />
      <small>
        {ticks.map((tick) => (
          <span key={tick}>{mm(tick, tick === from_m ? 1 : 0)}</span>
        ))}
      </small>
    </span>
  );
  return (
    <p class="small legend heights">
      {rich("result.heights.legend", { from: mm(from_m), table: <span class="table" />, scale })}
      <br />
      {t("result.heights.rest")}
    </p>
  );
}
