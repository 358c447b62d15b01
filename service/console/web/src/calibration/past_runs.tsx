import { useState } from "preact/hooks";
import { Badge } from "../bar/status";
import type { Run } from "../net/api";
import { when } from "../texts/format";
import { SCAN_TONES, scanWord } from "../texts/states";
import { t } from "../texts/translate";
import { kindText, RunPanel } from "./run_panel";
import { Verdict } from "./verdict";

/** Earlier runs; one of them can be opened. */
export function PastRuns({ runs, changed }: { runs: readonly Run[]; changed: (run: Run) => void }) {
  const [open, setOpen] = useState<string | null>(null);
  if (runs.length === 0) return null;
  return (
    <section aria-label={t("calibration.past.region")}>
      <h2>{t("calibration.past.region")}</h2>
      <ul class="past">
        {runs.map((run) => (
          <li key={run.id}>
            <button type="button" aria-expanded={open === run.id} onClick={() => setOpen(open === run.id ? null : run.id)}>
              {runName(run)} <RunOutcome run={run} />
            </button>
            {open === run.id && <RunPanel run={run} name={runName(run)} changed={changed} />}
          </li>
        ))}
      </ul>
    </section>
  );
}

function runName(run: Run): string {
  return t("common.kind_and_time", { kind: kindText(run), when: when(run.created_at) });
}

/** The outcome in a word. A run that succeeded may have a bad result. */
function RunOutcome({ run }: { run: Run }) {
  if (run.result) return <Verdict verdict={run.result.verdict} />;
  if (run.verification?.passed) return <Badge tone="good">{t("calibration.past.passed")}</Badge>;
  if (run.verification) return <Badge tone="bad">{t("calibration.past.failed")}</Badge>;
  return <Badge tone={SCAN_TONES[run.state]}>{scanWord(run.state)}</Badge>;
}
