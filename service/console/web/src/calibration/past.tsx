import { useState } from "preact/hooks";
import { Badge } from "../bar/status";
import type { Run } from "../net/api";
import { SCAN } from "../words/states";
import { when } from "../words/units";
import { nameOf, RunPanel } from "./run";
import { Verdict } from "./verdict";

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
              <Came run={run} />
            </button>
            {open === run.id && <RunPanel run={run} name={`${nameOf(run)}, ${when(run.created_at)}`} changed={changed} />}
          </li>
        ))}
      </ul>
    </section>
  );
}

/** What came of it in a word; a run that went well may have a result that is bad. */
function Came({ run }: { run: Run }) {
  const { word, look } = SCAN[run.state];
  if (run.result) return <Verdict verdict={run.result.verdict} />;
  if (run.verification?.passed) return <Badge look="good">held</Badge>;
  if (run.verification) return <Badge look="bad">did not hold</Badge>;
  return <Badge look={look}>{word}</Badge>;
}
