import type { Run } from "../net/api";
import { decimal } from "../texts/format";
import { sentence } from "../texts/sentence";
import { rich, t } from "../texts/translate";
import { Hint } from "../ui/hint";
import { Picture } from "../ui/picture";

type View = Run["progress"]["views"][number];

/** The views of a run, with the image of each, and how well the board was found in it. */
export function RunViews({ run }: { run: Run }) {
  const { views } = run.progress;
  if (views.length === 0) return null;
  const excluded = run.result?.views.filter((view) => !view.used) ?? [];
  const searched = views.filter((view) => view.state === "recorded" && (view.corners !== null || view.reason !== null));
  const found = searched.filter((view) => view.corners !== null);
  const residuals = <Hint term="residual">{t("calibration.views.residuals_term")}</Hint>;
  return (
    <>
      <p>{t("calibration.views.found", { found: found.length, count: searched.length })}</p>
      <p class="small">{rich("calibration.views.residuals", { residuals })}</p>
      <ol class="views" aria-label={t("common.views")}>
        {views.map((view) => (
          <li key={view.index} class={view.state === "recorded" && view.reason !== null ? "missing" : view.state}>
            {view.image === null ? (
              <span class="picture">{view.state === "moving" ? "..." : "✗"}</span>
            ) : (
              <Picture src={view.image} alt={t("calibration.views.alt", { index: view.index })} />
            )}
            {t("calibration.views.label", { index: view.index, state: stateText(view) })}
          </li>
        ))}
      </ol>
      {excluded.map(({ name, reason }) => (
        <p key={name} class="note warn">
          {sentence(
            t("calibration.views.excluded", {
              index: shownIndex(name),
              reason: reason ?? t("common.no_reason"),
            }),
          )}
        </p>
      ))}
    </>
  );
}

/** Return the shown number of a view that the solver calls `04_pose11`: the arm took the poses in another order. */
function shownIndex(name: string): string {
  const [, index] = /_pose(\d+)$/.exec(name) ?? [];
  return index === undefined ? name : String(Number(index));
}

function stateText(view: View): string {
  if (view.reason !== null) return view.reason;
  if (view.state === "moving") return t("view_state.moving");
  if (view.corners === null) return t("calibration.views.searching");
  const counts = { found: view.corners, possible: view.board_corners ?? view.corners };
  if (view.rms_px === null) return t("calibration.views.corners", counts);
  const residual = t("units.pixels", { value: decimal(view.rms_px, 2) });
  return t("calibration.views.corners_residual", { ...counts, residual });
}
