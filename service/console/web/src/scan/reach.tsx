import { useEffect, useMemo, useState } from "preact/hooks";
import { api, slowly, told, type Plan } from "../net/api";
import { atWork, cell } from "../state/cell";
import { room } from "../state/room";
import { Act, Failed, useAction } from "../ui/action";
import { Hint } from "../ui/hint";
import { Viewer } from "../viewer/viewer";
import type { ViewPose } from "../view3d/scene";
import { sentence } from "../words/sentence";

/** Which viewpoints the arm reaches, and why not the others: before anything moves. */
export function Reach({ views }: { views: number | null }) {
  const [plan, setPlan] = useState<{ of: number | null; plan: Plan } | null>(null);
  const [open, setOpen] = useState(false);
  const action = useAction();

  async function check(): Promise<void> {
    setPlan({ of: views, plan: await told(api.POST("/api/viewpoints/plan", { body: { views }, ...slowly })) });
  }

  const possible = !atWork.value && cell.value !== null && cell.value.state !== "fault";
  useEffect(() => {
    if (possible && plan === null) void action.run(check);
  }, [possible]);

  const shown = plan?.of === views ? plan.plan : null;
  return (
    <div class="reach">
      <div class="row">
        <strong>
          <Hint term="reachable">{shown === null ? "Reachable" : `Reachable: ${shown.reached} of ${shown.viewpoints.length}`}</Hint>
        </strong>
        <Act action={action} work={check} doing="Checking ...">
          {shown === null ? "Check which viewpoints can be reached" : "Check again"}
        </Act>
      </div>
      <Failed failure={action.failure} />
      {shown !== null && <Reached plan={shown} />}
      {shown !== null && (
        <details onToggle={(event) => setOpen(event.currentTarget.open)}>
          <summary>Show where they are</summary>
          {open && <Where plan={shown} />}
        </details>
      )}
    </div>
  );
}

/** The viewpoints that are reached, and the arm as it stands now. */
function Where({ plan }: { plan: Plan }) {
  const lens = room.value?.camera;
  const content = useMemo(() => {
    const reached = lens === undefined ? [] : plan.viewpoints.filter((one) => one.reason === null);
    const views = reached.map((one) => ({ ...lens, index: one.index, T_base_camera: one.T_base_camera, picture: "" }) as ViewPose);
    return { model: null, cloud: null, views, others: [] };
  }, [plan, lens]);
  return <Viewer content={content} layers={["cameras", "arm", "room", "labels"]} />;
}

function Reached({ plan }: { plan: Plan }) {
  return (
    <>
      <ol aria-label="Viewpoints">
        {plan.viewpoints.map((one) => (
          <li key={one.index} class={one.reason === null ? "good" : "warn"}>
            {one.index} {one.reason === null ? "✓ yes" : "▲ no"}
          </li>
        ))}
      </ol>
      {plan.viewpoints.map(
        (one) =>
          one.reason !== null && (
            <p key={one.index} class="note warn">
              {sentence(`Viewpoint ${one.index}: ${one.reason}`)}
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
