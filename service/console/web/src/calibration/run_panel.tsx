import { Badge } from "../bar/status";
import { api, longCall, resultOf, type Run } from "../net/api";
import { percent, when } from "../texts/format";
import { sentence } from "../texts/sentence";
import { isActive, SCAN_TONES, scanWord } from "../texts/states";
import { t } from "../texts/translate";
import { Act, Failed, useAction } from "../ui/action";
import { EndReason } from "../ui/end_reason";
import { boardText } from "./board";
import { Coverage } from "./coverage";
import { Outcome } from "./outcome";
import { RunViews } from "./run_views";

interface RunProps {
  run: Run;
  /** Accessible name of the panel. */
  name: string;
  changed: (run: Run) => void;
}

/** Return the kind of a run, for people. */
export function kindText(run: Run): string {
  return t(`calibration.run.${run.kind}`);
}

/** A calibration or verification: its progress and its outcome. */
export function RunPanel({ run, name, changed }: RunProps) {
  const cancel = useAction();
  const { progress, problem } = run;
  const board = boardText(run.board);
  const created = when(run.created_at);
  return (
    <section class="panel" aria-label={name}>
      <h2>
        {kindText(run)}{" "}
        <Badge tone={SCAN_TONES[run.state]}>
          {run.state === "processing" ? t("calibration.run.processing") : scanWord(run.state)}
        </Badge>
      </h2>
      <p class="small">{board === null ? created : t("calibration.run.with_board", { when: created, board })}</p>
      {isActive(run.state) && (
        <>
          <div class="done">
            <progress max={1} value={progress.fraction} aria-label={t("common.progress")} />
            <span>{percent(progress.fraction)}</span>
          </div>
          <Act
            action={cancel}
            doing={t("common.stopping")}
            disabled={run.links.cancel === null || run.state === "stopping"}
            work={async () => {
              const params = { path: { id: run.id } };
              changed(await resultOf(api.POST("/api/calibration/runs/{id}/cancel", { params, ...longCall })));
            }}
          >
            {t("calibration.run.cancel")}
          </Act>
          <Failed failure={cancel.failure} />
        </>
      )}
      <EndReason state={run.state} problem={problem} />
      {run.warnings.map((warning) => (
        <p key={warning} class="note warn">
          ▲ {sentence(warning)}
        </p>
      ))}
      <Outcome run={run} changed={changed} />
      {run.kind === "calibration" && progress.views.length > 0 && <Coverage progress={progress} />}
      <RunViews run={run} />
    </section>
  );
}
