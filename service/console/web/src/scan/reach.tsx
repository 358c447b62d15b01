import { useEffect, useState } from "preact/hooks";
import { api, slowly, told, type Plan } from "../net/api";
import { atWork, cell } from "../state/cell";
import { Act, Failed, sentence, useAction } from "../ui/action";
import { Hint } from "../ui/hint";

/** Which viewpoints the arm reaches, and why not the others: before anything moves. */
export function Reach({ views }: { views: number | null }) {
  const [plan, setPlan] = useState<{ of: number | null; plan: Plan } | null>(null);
  const action = useAction();

  async function check(): Promise<void> {
    setPlan({ of: views, plan: await told(api.POST("/api/viewpoints/plan", { body: { views }, ...slowly })) });
  }

  useEffect(() => {
    if (!atWork.value && cell.value?.state !== "fault") void action.run(check);
  }, []);

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
    </div>
  );
}

function Reached({ plan }: { plan: Plan }) {
  return (
    <>
      <ol aria-label="Viewpoints">
        {plan.viewpoints.map((one) => (
          <li key={one.index} class={one.reason === null ? "good" : "warn"}>
            {one.index + 1} {one.reason === null ? "✓ yes" : "▲ no"}
          </li>
        ))}
      </ol>
      {plan.viewpoints.map(
        (one) =>
          one.reason !== null && (
            <p key={one.index} class="note warn">
              Viewpoint {one.index + 1}: {sentence(one.reason)}
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
