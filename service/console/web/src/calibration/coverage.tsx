import type { Run } from "../net/api";
import { percent } from "../texts/format";
import { rich, t } from "../texts/translate";
import { Hint } from "../ui/hint";

const COLUMNS = 8;
const ROWS = 5;

/** The parts of the image in which the board was seen so far. */
export function Coverage({ progress }: { progress: Run["progress"] }) {
  const seen = new Set(progress.views.flatMap((view) => view.cells ?? []));
  const label = <Hint term="coverage">{t("calibration.coverage.label")}</Hint>;
  return (
    <div class="coverage">
      <p>{rich("calibration.coverage.text", { coverage: label, value: percent(progress.coverage) })}</p>
      <div
        class="cells"
        role="img"
        aria-label={t("calibration.coverage.image", { seen: seen.size, total: COLUMNS * ROWS })}
      >
        {Array.from({ length: COLUMNS * ROWS }, (_, cell) => (
          <span key={cell} class={seen.has(cell) ? "seen" : ""} />
        ))}
      </div>
    </div>
  );
}
