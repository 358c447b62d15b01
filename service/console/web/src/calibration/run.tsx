import { Badge } from "../bar/status";
import { api, slowly, told, type Run } from "../net/api";
import { Act, Failed, useAction } from "../ui/action";
import { sentence } from "../words/sentence";
import { WhyEnded } from "../ui/why_ended";
import { SCAN, underWay } from "../words/states";
import { percent, when } from "../words/units";
import { boardWords } from "./board";
import { Coverage } from "./coverage";
import { Outcome } from "./outcome";
import { RunViews } from "./views";

interface RunProps {
  run: Run;
  /** Which of the runs this is. */
  name: string;
  changed: (run: Run) => void;
}

/** What a run is called. */
export function nameOf(run: Run): string {
  return run.kind === "calibration" ? "Calibration" : "Verification";
}

/** A calibration or verification: how it goes, and what came of it. */
export function RunPanel({ run, name, changed }: RunProps) {
  const cancel = useAction();
  const { word, look } = SCAN[run.state];
  const active = underWay(run.state);
  const { progress, problem } = run;
  const board = boardWords(run.board);
  return (
    <section class="panel" aria-label={name}>
      <h2>
        {nameOf(run)}{" "}
        <Badge look={look}>{run.state === "processing" ? "Working it out" : word}</Badge>
      </h2>
      <p class="small">
        {when(run.created_at)}
        {board !== null && `; board: ${board}`}
      </p>
      {active && (
        <>
          <div class="done">
            <progress max={1} value={progress.fraction} aria-label="Done of the whole" />
            <span>{percent(progress.fraction)}</span>
          </div>
          <Act
            action={cancel}
            doing="Stopping ..."
            disabled={run.links.cancel === null || run.state === "stopping"}
            work={async () => {
              const params = { path: { id: run.id } };
              changed(await told(api.POST("/api/calibration/runs/{id}/cancel", { params, ...slowly })));
            }}
          >
            Cancel: the arm stops
          </Act>
          <Failed failure={cancel.failure} />
        </>
      )}
      <WhyEnded state={run.state} problem={problem} />
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
