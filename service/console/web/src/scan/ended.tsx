import type { Scan } from "../net/api";
import { Badge } from "../bar/status";
import { addressOf } from "../route";
import { sentence } from "../ui/action";
import { hasModel, SCAN } from "../words/states";
import { counted, when } from "../words/units";
import { Views } from "./views";

/** The last scan: what came of it. */
export function Ended({ scan }: { scan: Scan }) {
  const { word, look } = SCAN[scan.state];
  const { summary, problem } = scan;
  return (
    <section class="panel" aria-label="The last scan">
      <h2>
        <Badge look={look}>{word}</Badge>{" "}
        {summary && (
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
      {summary?.warnings.map((warning) => (
        <p key={warning} class="note warn">
          {sentence(warning)}
        </p>
      ))}
      <p class="row">
        {hasModel(scan) && (
          <a class="button main" href={addressOf("result", scan.id)}>
            Look at the result
          </a>
        )}
        {!hasModel(scan) && scan.links.reprocess !== null && (
          <a class="button" href={addressOf("history", scan.id)}>
            Work with what was recorded
          </a>
        )}
      </p>
      {scan.mode === "live" && <Views scan={scan} />}
    </section>
  );
}
