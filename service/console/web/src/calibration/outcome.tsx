import { api, resultOf, type Run } from "../net/api";
import { refreshCalibration } from "../state/cell";
import { canMaintain } from "../state/session";
import { mm, plusMinus, when } from "../texts/format";
import { sentence } from "../texts/sentence";
import { rich, t } from "../texts/translate";
import { Act, Failed, useAction } from "../ui/action";
import { HintedEntry } from "../ui/hint";
import { scaleText } from "./board";
import { Findings } from "./findings";
import { Verdict } from "./verdict";

interface OutcomeProps {
  run: Run;
  changed: (run: Run) => void;
}

/** The outcome of a run: its verdict, its figures, and the button that activates it. */
export function Outcome({ run, changed }: OutcomeProps) {
  const { result, verification } = run;
  return (
    <>
      {result && <Result result={result} verified={verification !== null} />}
      {verification && (
        <p class={`note ${verification.passed ? "good" : "bad"}`}>
          {verification.passed
            ? t("calibration.outcome.passed", { message: sentence(verification.message) })
            : t("calibration.outcome.failed", { message: sentence(verification.message) })}
        </p>
      )}
      {run.activated_at !== null && (
        <p class="note good">{t("calibration.outcome.active_since", { when: when(run.activated_at) })}</p>
      )}
      {run.activated_at === null && <Activate run={run} changed={changed} />}
    </>
  );
}

function Result({ result, verified }: { result: NonNullable<Run["result"]>; verified: boolean }) {
  const { sigma_m, repeatability_95_m, views_used: used, views_given: total } = result.metrics;
  const unknown = t("common.unknown");
  return (
    <>
      <p>{rich("calibration.outcome.verdict", { verdict: <Verdict verdict={result.verdict} /> })}</p>
      <Findings findings={result.findings} />
      <dl class="figures">
        <HintedEntry term="sigma" name={t("calibration.sigma")}>
          {sigma_m === null ? unknown : plusMinus(sigma_m)}
        </HintedEntry>
        <dt>{t("calibration.repeatability")}</dt>
        <dd>{repeatability_95_m === null ? unknown : mm(repeatability_95_m, 2)}</dd>
        <dt>{t("calibration.outcome.images")}</dt>
        <dd>
          {verified
            ? t("calibration.outcome.images_verified", { used, total })
            : t("calibration.outcome.images_of", { used, total })}
        </dd>
        <HintedEntry term="board_scale" name={t("calibration.outcome.board_scale")}>
          {scaleText(result.board) ?? unknown}
        </HintedEntry>
      </dl>
    </>
  );
}

function Activate({ run, changed }: OutcomeProps) {
  const action = useAction();
  if (run.links.activate === null || !canMaintain.value) return null;
  return (
    <>
      <Act
        action={action}
        kind="main"
        work={async () => {
          changed(await resultOf(api.POST("/api/calibration/runs/{id}/activate", { params: { path: { id: run.id } } })));
          await refreshCalibration();
        }}
      >
        {t("calibration.outcome.activate")}
      </Act>
      <Failed failure={action.failure} />
    </>
  );
}
