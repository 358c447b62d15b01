import type { Run } from "../net/api";
import { Hint } from "../ui/hint";
import { percent } from "../words/units";

const COLUMNS = 8;
const ROWS = 5;

/** In which parts of the picture the board was seen so far. */
export function Coverage({ progress }: { progress: Run["progress"] }) {
  const seen = new Set(progress.views.flatMap((view) => view.cells ?? []));
  return (
    <div class="coverage">
      <p>
        <Hint term="coverage">Coverage</Hint>: {percent(progress.coverage)}
      </p>
      <div class="cells" role="img" aria-label={`The board was seen in ${seen.size} of ${COLUMNS * ROWS} parts of the picture`}>
        {Array.from({ length: COLUMNS * ROWS }, (_, cell) => (
          <span key={cell} class={seen.has(cell) ? "seen" : ""} />
        ))}
      </div>
    </div>
  );
}
