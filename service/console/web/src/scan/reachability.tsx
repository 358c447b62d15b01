import { useEffect, useMemo, useState } from "preact/hooks";
import { api, longCall, resultOf, type Plan, type Scan } from "../net/api";
import { atWork, cell } from "../state/cell";
import { geometry } from "../state/geometry";
import { sentence } from "../texts/sentence";
import { t } from "../texts/translate";
import { Act, Failed, useAction } from "../ui/action";
import { Hint } from "../ui/hint";
import type { ViewPose } from "../view3d/scene";
import { Viewer } from "../viewer/viewer";

/**
 * Which viewpoints the arm can reach, and why not the others, before anything moves.
 * The key of this component is `views`, so that other viewpoints are checked at once.
 */
export function Reachability({ views }: { views: Scan["views"] }) {
  const [plan, setPlan] = useState<Plan | null>(null);
  const [open, setOpen] = useState(false);
  const action = useAction();

  async function check(): Promise<void> {
    setPlan(await resultOf(api.POST("/api/viewpoints/plan", { body: { views }, ...longCall })));
  }

  const possible = !atWork.value && cell.value !== null && cell.value.state !== "fault";
  useEffect(() => {
    if (possible && plan === null) void action.run(check);
  }, [possible]);

  return (
    <div class="reach">
      <div class="row">
        <strong>
          <Hint term="reachable">{plan === null ? t("scan.reach.label") : countText(plan)}</Hint>
        </strong>
        <Act action={action} work={check} doing={t("scan.reach.checking")}>
          {plan === null ? t("scan.reach.check") : t("scan.reach.check_again")}
        </Act>
      </div>
      <Failed failure={action.failure} />
      {plan !== null && <ViewpointList plan={plan} />}
      {plan !== null && (
        <details onToggle={(event) => setOpen(event.currentTarget.open)}>
          <summary>{t("scan.reach.show")}</summary>
          {open && <ReachableIn3D plan={plan} />}
        </details>
      )}
    </div>
  );
}

function countText({ reachable, viewpoints }: Plan): string {
  return t("scan.reach.count", { reachable, planned: viewpoints.length });
}

/** The reachable viewpoints and the current pose of the arm. */
function ReachableIn3D({ plan }: { plan: Plan }) {
  const lens = geometry.value?.camera;
  const content = useMemo(() => {
    const reachable = lens === undefined ? [] : plan.viewpoints.filter((one) => one.reason === null);
    const views = reachable.map(
      ({ index, T_base_camera }) => ({ ...lens, index, T_base_camera, image: "" }) as ViewPose,
    );
    return { model: null, cloud: null, views, others: [] };
  }, [plan, lens]);
  return <Viewer content={content} layers={["cameras", "arm", "geometry", "labels"]} />;
}

function ViewpointList({ plan }: { plan: Plan }) {
  return (
    <>
      <ol aria-label={t("scan.reach.list")}>
        {plan.viewpoints.map(({ index, reason }) => (
          <li key={index} class={reason === null ? "good" : "warn"}>
            {reason === null ? t("scan.reach.yes", { index }) : t("scan.reach.no", { index })}
          </li>
        ))}
      </ol>
      {plan.viewpoints.map(
        ({ index, reason }) =>
          reason !== null && (
            <p key={index} class="note warn">
              {sentence(t("scan.reach.reason", { index, reason }))}
            </p>
          ),
      )}
      {[plan.coverage.warning, ...plan.warnings].map(
        (warning) =>
          warning !== null && (
            <p key={warning} class="note warn">
              {sentence(warning)}
            </p>
          ),
      )}
    </>
  );
}
