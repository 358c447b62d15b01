import type { Run } from "../net/api";
import { Hint } from "../ui/hint";
import { Picture } from "../ui/picture";
import { sentence } from "../words/sentence";
import { counted } from "../words/units";

type View = Run["progress"]["views"][number];

/** The views of a run, with their pictures as they come in, and how well the board was found in each. */
export function RunViews({ run }: { run: Run }) {
  const { views } = run.progress;
  if (views.length === 0) return null;
  const left = run.result?.views.filter((view) => !view.used) ?? [];
  const looked = views.filter((view) => view.state === "recorded" && (view.corners !== null || view.reason !== null));
  const found = looked.filter((view) => view.corners !== null);
  return (
    <>
      <p>
        The board was found in {found.length} of {counted(looked.length, "view")}.
      </p>
      <p class="small">
        <Hint term="residual">Residuals</Hint> are in pixels, each of its own view.
      </p>
      <ol class="views" aria-label="Views">
        {views.map((view) => (
          <li key={view.index} class={view.state === "recorded" && view.reason !== null ? "missing" : view.state}>
            {view.picture === null ? (
              <span class="picture">{view.state === "moving" ? "..." : "✗"}</span>
            ) : (
              <Picture src={view.picture} alt={`What the camera saw in view ${view.index}`} />
            )}
            {view.index}: {wordsOf(view)}
          </li>
        ))}
      </ol>
      {left.map(({ name, reason }) => (
        <p key={name} class="note warn">
          ▲ {sentence(`View ${numberOf(name)} was left out: ${reason ?? "no reason is told"}`)}
        </p>
      ))}
    </>
  );
}

/** The number shown of a view that solving calls `04_pose11`: the arm took the poses in another order. */
function numberOf(name: string): string {
  const [, index] = /_pose(\d+)$/.exec(name) ?? [];
  return index === undefined ? name : String(Number(index));
}

function wordsOf(view: View): string {
  if (view.reason !== null) return view.reason;
  if (view.state === "moving") return "on the way";
  if (view.corners === null) return "looking for the board";
  const residual = view.rms_px === null ? "" : `, ${view.rms_px.toFixed(2)}\u00a0px`;
  return `${view.corners} of ${view.possible ?? view.corners} corners${residual}`;
}
