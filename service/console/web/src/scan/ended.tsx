import type { Scan } from "../net/api";
import { Badge } from "../bar/status";
import { addressOf } from "../route";
import { operates } from "../state/session";
import { Warnings } from "../ui/warnings";
import { sentence } from "../words/sentence";
import { hasModel, outcome } from "../words/states";
import { counted, when } from "../words/units";
import { ToldRadius } from "./told_radius";
import { Views } from "./views";

/** The last scan: what came of it. */
export function Ended({ scan }: { scan: Scan }) {
  const { word, look } = outcome(scan);
  const { summary, problem } = scan;
  return (
    <section class="panel" aria-label="The last scan">
      <h2>
        <Badge look={look}>{word}</Badge>{" "}
        {summary !== null && summary.chains > 0 && (
          <span>
            {counted(summary.chains, "string")}, {counted(summary.crossings, "crossing")}
          </span>
        )}
      </h2>
      <p class="small">
        {scan.mode === "live" ? "By the cell" : "From a recording"}, {when(scan.created_at)}, {scan.method}
      </p>
      {problem && (
        <p class="note bad">
          <strong>{problem.title}.</strong> {sentence(problem.detail)}
        </p>
      )}
      <ToldRadius scan={scan} />
      <Warnings warnings={summary?.warnings ?? []} />
      <p class="row">
        {hasModel(scan) && (
          <a class="button main" href={addressOf("result", scan.id)}>
            Look at the result
          </a>
        )}
        {!hasModel(scan) && scan.links.reprocess !== null && (
          <a class="button" href={addressOf("history", scan.id)}>
            {operates.value ? "Work with what was recorded" : "See what was recorded"}
          </a>
        )}
      </p>
      {scan.mode === "live" && !hasModel(scan) && (
        <p>{counted(scan.progress.views.filter((view) => view.state === "recorded").length, "view")} had been taken.</p>
      )}
      {scan.mode === "live" && <Views scan={scan} />}
    </section>
  );
}
