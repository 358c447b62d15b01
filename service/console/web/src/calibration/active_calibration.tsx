import { Badge } from "../bar/status";
import { calibration } from "../state/cell";
import { geometry } from "../state/geometry";
import { mm, plusMinus, span } from "../texts/format";
import { sentence } from "../texts/sentence";
import { rich, t } from "../texts/translate";
import { HintedEntry } from "../ui/hint";
import { boardText } from "./board";
import { Findings } from "./findings";
import { Verdict } from "./verdict";

/** The active calibration: its verdict, age and accuracy. */
export function ActiveCalibration() {
  const status = calibration.value;
  if (status === null) return <p>{t("common.loading")}</p>;
  const used = status.calibration;
  if (used === null) {
    return (
      <section class="panel" aria-label={t("calibration.active.region")}>
        <h2>
          <Badge tone="bad">{t("calibration.active.none")}</Badge>
        </h2>
        <p>{sentence(status.reason ?? t("calibration.active.calibrate_first"))}</p>
      </section>
    );
  }
  const unknown = t("common.unknown");
  return (
    <section class="panel" aria-label={t("calibration.active.region")}>
      <h2>{rich("calibration.active.title", { verdict: <Verdict verdict={used.verdict} /> })}</h2>
      <dl class="figures">
        <dt>{t("calibration.active.age")}</dt>
        <dd>{ageText(used.age_s === null ? unknown : span(used.age_s))}</dd>
        <HintedEntry term="sigma" name={t("calibration.sigma")}>
          {used.sigma_m === null ? unknown : plusMinus(used.sigma_m)}
        </HintedEntry>
        <dt>{t("calibration.repeatability")}</dt>
        <dd>{used.repeatability_95_m === null ? unknown : mm(used.repeatability_95_m, 2)}</dd>
        <HintedEntry term="drift" name={t("calibration.active.drift")} tone={used.drift.drifted ? "bad" : ""}>
          {sentence(used.drift.message)}
        </HintedEntry>
        <dt>{t("calibration.active.board")}</dt>
        <dd>{boardText(used.board) ?? unknown}</dd>
      </dl>
      {[...status.warnings.map((warning) => warning.message), ...used.warnings].map((message) => (
        <p key={message} class="note warn">
          ▲ {sentence(message)}
        </p>
      ))}
      <Findings findings={used.findings} />
    </section>
  );
}

function ageText(age: string): string {
  const days = geometry.value?.hand_eye_max_age_days;
  return days === undefined ? age : t("calibration.active.age_limit", { age, days });
}
