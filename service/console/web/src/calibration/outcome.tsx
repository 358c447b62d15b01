import { api, told, type Run } from "../net/api";
import { askCalibration } from "../state/cell";
import { maintains } from "../state/session";
import { Act, Failed, useAction } from "../ui/action";
import { Hint } from "../ui/hint";
import { sentence } from "../words/sentence";
import { mm, when } from "../words/units";
import { scaleWords } from "./board";
import { Findings } from "./findings";
import { Verdict } from "./verdict";

/** What came of a run: the verdict first, and whether it is to be used. */
export function Outcome({ run, changed }: { run: Run; changed: (run: Run) => void }) {
  const { result, verification } = run;
  return (
    <>
      {result && (
        <>
          <p>
            The result: <Verdict verdict={result.verdict} />
          </p>
          <Findings findings={result.findings} />
          <dl class="figures">
            <dt>
              <Hint term="sigma">Camera's place, sure to</Hint>
            </dt>
            <dd>± {orUnknown(result.metrics.sigma_m)}</dd>
            <dt>Eight views agree within</dt>
            <dd>{orUnknown(result.metrics.eight_views_m)}</dd>
            <dt>Pictures used</dt>
            <dd>
              {result.metrics.views_used} of {result.metrics.views_given}
              {verification && "; the others were kept to judge it by"}
            </dd>
            <dt>
              <Hint term="board scale">Size of the board, by the views</Hint>
            </dt>
            <dd>{scaleWords(result.board) ?? "not known"}</dd>
          </dl>
        </>
      )}
      {verification && (
        <p class={`note ${verification.passed ? "good" : "bad"}`}>
          {verification.passed ? "✓ It holds on views that it was not made from. " : "⬣ It does not hold. "}
          {sentence(verification.words)}
        </p>
      )}
      {run.activated_at !== null && <p class="note good">✓ In use since {when(run.activated_at)}.</p>}
      {run.activated_at === null && <Activate run={run} changed={changed} />}
    </>
  );
}

function orUnknown(metres: number | null): string {
  return metres === null ? "not known" : mm(metres, 2);
}

function Activate({ run, changed }: { run: Run; changed: (run: Run) => void }) {
  const action = useAction();
  if (run.links.activate === null || !maintains.value) return null;
  return (
    <>
      <Act
        action={action}
        kind="main"
        work={async () => {
          changed(await told(api.POST("/api/calibration/runs/{id}/activate", { params: { path: { id: run.id } } })));
          await askCalibration();
        }}
      >
        Use this calibration from now on
      </Act>
      <Failed failure={action.failure} />
    </>
  );
}
