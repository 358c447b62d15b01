import type { Finding, Scan } from "../net/api";
import { distinctFindings, FINDING_TONES, findingText, originalOf } from "../texts/findings";
import { SHAPES } from "../texts/states";
import { t } from "../texts/translate";

/** Number of doubts that are shown at once. The service lists the most serious ones first. */
const SHOWN = 3;

/** The doubts and blocking findings of a scan; further ones are collapsed. */
export function Doubts({ summary }: { summary: Scan["summary"] }) {
  if (summary === null) return null;
  const doubts = distinctFindings(summary.doubts);
  const more = doubts.slice(SHOWN);
  const unlisted = summary.doubt_count - summary.doubts.length;
  return (
    <>
      <DoubtList doubts={doubts.slice(0, SHOWN)} />
      {more.length > 0 && (
        <details>
          <summary>{t("doubts.more", { count: more.length })}</summary>
          <DoubtList doubts={more} />
        </details>
      )}
      {unlisted > 0 && <p class="note warn">{t("doubts.unlisted", { count: unlisted })}</p>}
    </>
  );
}

function DoubtList({ doubts }: { doubts: readonly Finding[] }) {
  return (
    <>
      {doubts.map((finding) => (
        <p key={finding.message} class={`note ${FINDING_TONES[finding.severity]}`} title={originalOf(finding)}>
          <span aria-hidden="true">{SHAPES[FINDING_TONES[finding.severity]]}</span> {findingText(finding)}
        </p>
      ))}
    </>
  );
}
