import { Badge } from "../bar/status";
import { calibration } from "../state/cell";
import { room } from "../state/room";
import { Hint } from "../ui/hint";
import { sentence } from "../words/sentence";
import { mm, span } from "../words/units";
import { boardWords } from "./board";
import { Findings } from "./findings";
import { Verdict } from "./verdict";

/** The calibration in use: whether it is good, and how old. */
export function InUse() {
  const told = calibration.value;
  if (told === null) return <p>Asking ...</p>;
  const used = told.calibration;
  if (used === null) {
    return (
      <section class="panel" aria-label="In use">
        <h2>
          <Badge look="bad">There is none that can be used</Badge>
        </h2>
        <p>{sentence(told.reason ?? "Calibrate first")}</p>
      </section>
    );
  }
  const most = room.value?.hand_eye_max_age_days;
  return (
    <section class="panel" aria-label="In use">
      <h2>
        In use: <Verdict verdict={used.verdict} />
      </h2>
      <dl class="figures">
        <dt>Age</dt>
        <dd>
          {used.age_s === null ? "not known" : span(used.age_s)}
          {most !== undefined && `; older than ${most} days is refused`}
        </dd>
        <dt>
          <Hint term="sigma">Camera's place, sure to</Hint>
        </dt>
        <dd>{used.sigma_m === null ? "not known" : `± ${mm(used.sigma_m, 2)}`}</dd>
        <dt>Eight views agree within</dt>
        <dd>{used.eight_views_m === null ? "not known" : mm(used.eight_views_m, 2)}</dd>
        <dt>
          <Hint term="drift">What recent scans tell</Hint>
        </dt>
        <dd class={used.drift.drifted ? "bad" : ""}>{sentence(used.drift.words)}</dd>
        <dt>Made with the board</dt>
        <dd>{boardWords(used.board) ?? "not known"}</dd>
      </dl>
      {[...told.warnings.map((warning) => warning.words), ...used.warnings].map((words) => (
        <p key={words} class="note warn">
          ▲ {sentence(words)}
        </p>
      ))}
      <Findings findings={used.findings} />
    </section>
  );
}
