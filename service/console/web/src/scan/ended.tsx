import type { Scan } from "../net/api";
import { Badge } from "../bar/status";
import { addressOf } from "../route";
import { operates } from "../state/session";
import { WhyEnded } from "../ui/why_ended";
import { Warnings } from "../ui/warnings";
import { hasModel, isElsewhere, kindOf, outcome, takenIn, tooFew } from "../words/states";
import { counted, when } from "../words/units";
import { RecordingName } from "./recording_name";
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
        {kindOf(scan)}, {when(scan.created_at)}, {scan.method}
        {isElsewhere(scan) && scan.recording !== null && <RecordingName id={scan.recording} />}
      </p>
      <WhyEnded state={scan.state} problem={problem} />
      <ToldRadius scan={scan} />
      <Warnings warnings={summary?.warnings ?? []} />
      <p class="row">
        {hasModel(scan) && (
          <a class="button main" href={addressOf("result", scan.id)}>
            Look at the result
          </a>
        )}
        {!hasModel(scan) && scan.links.reprocess !== null && !tooFew(scan) && operates.value && (
          <a class="button" href={addressOf("history", scan.id)}>
            Work with what was recorded
          </a>
        )}
      </p>
      {scan.mode === "live" && !hasModel(scan) && <p>{counted(takenIn(scan), "view")} had been taken.</p>}
      {scan.mode === "live" && scan.state === "interrupted" && (
        <p class="note warn">The robot stops by itself when the service ends. See how the arm stands before it moves again.</p>
      )}
      {scan.mode === "live" && <Views scan={scan} />}
    </section>
  );
}
