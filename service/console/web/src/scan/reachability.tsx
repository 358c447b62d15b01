import { useEffect } from "preact/hooks";
import { api, longCall, resultOf, type Plan, type Scan } from "../net/api";
import { atWork, cell } from "../state/cell";
import { sentence } from "../texts/sentence";
import { t } from "../texts/translate";
import { Act, Failed, useAction } from "../ui/action";
import { Hint } from "../ui/hint";
import { checkedPlan } from "./form_state";

/**
 * What a scan would do: which viewpoints the arm reaches, and why not the others, before anything moves.
 * The key of this component is `views`, so that other viewpoints are checked at once.
 */
export function Reachability({ views }: { views: Scan["views"] }) {
  const plan = checkedPlan.value;
  const action = useAction();

  async function check(): Promise<void> {
    checkedPlan.value = await resultOf(api.POST("/api/viewpoints/plan", { body: { views }, ...longCall }));
  }

  useEffect(() => {
    checkedPlan.value = null; // the plan was for other viewpoints
  }, []);
  const possible = !atWork.value && cell.value !== null && cell.value.state !== "fault";
  useEffect(() => {
    if (possible && checkedPlan.value === null) void action.run(check);
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
      {/* Always there, so that the page does not move under a finger when the plan comes. */}
      <p class="small">{plan === null ? "\u00a0" : motionText(plan)}</p>
      {plan !== null && <Unreachable plan={plan} />}
    </div>
  );
}

function countText({ reachable, viewpoints }: Plan): string {
  return t("scan.reach.count", { reachable, planned: viewpoints.length });
}

/** Say what the arm will do. */
function motionText({ reachable, duration_s, first, early_duration_s }: Plan): string {
  const all = { count: reachable, seconds: Math.round(duration_s) };
  if (early_duration_s === null) return t("scan.reach.motion", all);
  return t("scan.reach.motion_quick", { ...all, first: first.length, early: Math.round(early_duration_s) });
}

/** The viewpoints that the arm does not reach, with the reasons, and further warnings. */
function Unreachable({ plan }: { plan: Plan }) {
  return (
    <>
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
