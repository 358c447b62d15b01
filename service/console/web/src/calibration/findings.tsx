import type { components } from "../../generated/api";
import { sentence } from "../texts/sentence";

/** The findings about a calibration. */
export function Findings({ findings }: { findings: readonly components["schemas"]["FindingResource"][] }) {
  return (
    <>
      {findings.map((finding) => (
        <p key={finding.code} class={`note ${finding.blocking ? "bad" : "warn"}`}>
          {finding.blocking ? "⬣" : "▲"} {sentence(finding.message)}
        </p>
      ))}
    </>
  );
}
