import type { Finding, Model } from "../net/api";
import { decimal, degrees, mm, percent, pointText } from "./format";
import { sentence } from "./sentence";
import type { Tone } from "./states";
import { fillText, languageTag, t } from "./translate";

/** How a finding is drawn. */
export const FINDING_TONES: Record<Finding["severity"], Tone> = { blocking: "bad", doubt: "warn", note: "none" };

const count = (value: number) => decimal(value, 0);
const length = (value: number) => mm(value, 0);

/** How the value and the limit of a finding are written, by its code. Other codes have none in their texts. */
const UNITS: Readonly<Record<string, (value: number) => string>> = {
  "sharp-bend": degrees,
  "tight-bend": degrees,
  "crossing-undecided": percent,
  "upper-strand-unseen": percent,
  "ends-touching": mm,
  "possible-branch": mm,
  "possible-rod": mm,
  "possible-object": percent,
  "above-table": mm,
  "radius-much-smaller": mm,
  "radius-uncertain": mm,
  "possible-string": length,
  "string-of-other-radius": mm,
  "table-not-covered": percent,
  "calibration-drift": count,
  "table-elsewhere": count,
  "depth-noise": mm,
  "radius-smaller": mm,
  "radius-larger": mm,
  "no-trusted-grasp": count,
  "low-objects-hidden": mm,
  "piece-too-short": length,
  "piece-hardly-seen": length,
  "piece-not-round": length,
  "piece-in-table": length,
  "piece-upright": length,
  "more-pieces": count,
  "unexplained-surface": length,
  "more-unexplained-surface": count,
  "table-uncertain": percent,
  "depth-warp": mm,
  "stereo-depth-corrected": mm,
  "more-views-needed": count,
};

/** Return the findings, each message once: a finding about several strings is listed once for each of them. */
export function distinctFindings(findings: Model["quality"]["findings"]): Finding[] {
  const byMessage = new Map<string, Finding>();
  for (const finding of findings as Finding[]) {
    if (!byMessage.has(finding.message)) byMessage.set(finding.message, finding);
  }
  return [...byMessage.values()];
}

/**
 * Return the text of a finding: the catalogue's `finding.<code>` if the finding has all its placeholders, or else the
 * service's message.
 */
export function findingText(finding: Finding): string {
  return fillText(`finding.${finding.code}`, placeholdersOf(finding)) ?? sentence(finding.message);
}

/** Return the service's English message of a finding whose text is a translation; undefined if it is shown itself. */
export function originalOf(finding: Finding): string | undefined {
  const message = sentence(finding.message);
  return findingText(finding).includes(message) ? undefined : message;
}

/** Return what a finding carries, by the placeholders of the texts. */
function placeholdersOf({ code, message, chains = [], ...found }: Finding): Record<string, string | number> {
  const values: Record<string, string | number> = { message: sentence(message) };
  if (chains.length > 0) values.strings = new Intl.ListFormat(languageTag()).format(chains.map(String));
  if (found.crossing !== undefined) values.crossing = found.crossing;
  if (found.view !== undefined) values.view = found.view;
  if (found.end !== undefined) values.end = t(`finding_end.${found.end}`);
  if (found.point_m !== undefined) values.position = pointText(found.point_m);
  const [from_m, to_m] = found.s_range_m ?? [];
  if (from_m !== undefined && to_m !== undefined) {
    values.from = decimal(from_m * 1000, 0);
    values.to = mm(to_m, 0);
  }
  const written = UNITS[code];
  if (written !== undefined && found.value !== undefined) values.value = written(found.value);
  if (written !== undefined && found.limit !== undefined) values.limit = written(found.limit);
  return values;
}
