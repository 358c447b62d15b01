import { useState } from "preact/hooks";
import { Badge } from "../bar/status";
import type { Run } from "../net/api";
import { SCAN, VERDICTS } from "../words/states";
import { when } from "../words/units";
import { nameOf, RunPanel } from "./run";

/** Earlier runs; one of them can be opened. */
export function PastRuns({ runs, changed }: { runs: readonly Run[]; changed: (run: Run) => void }) {
  const [open, setOpen] = useState<string | null>(null);
  if (runs.length === 0) return null;
  return (
    <section aria-label="Earlier">
      <h2>Earlier</h2>
      <ul class="past">
        {runs.map((run) => (
          <li key={run.id}>
            <button type="button" aria-expanded={open === run.id} onClick={() => setOpen(open === run.id ? null : run.id)}>
              {nameOf(run)}, {when(run.created_at)}{" "}
              <Badge look={SCAN[run.state].look}>{outcomeOf(run)}</Badge>
            </button>
            {open === run.id && <RunPanel run={run} changed={changed} />}
          </li>
        ))}
      </ul>
    </section>
  );
}

function outcomeOf(run: Run): string {
  if (run.result) return VERDICTS[run.result.verdict];
  if (run.verification) return run.verification.passed ? "held" : "did not hold";
  return SCAN[run.state].word;
}
