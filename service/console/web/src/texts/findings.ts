import type { Finding, Model } from "../net/api";
import type { Tone } from "./states";

/** How a finding is drawn. */
export const FINDING_TONES: Record<Finding["severity"], Tone> = { blocking: "bad", doubt: "warn", note: "none" };

/** Return the findings, each message once: a finding about several strings is listed once for each of them. */
export function distinctFindings(findings: Model["quality"]["findings"]): Finding[] {
  const byMessage = new Map<string, Finding>();
  for (const finding of findings as Finding[]) {
    if (!byMessage.has(finding.message)) byMessage.set(finding.message, finding);
  }
  return [...byMessage.values()];
}
