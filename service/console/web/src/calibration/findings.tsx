import type { components } from "../../generated/api";
import { sentence } from "../words/sentence";

/** What speaks against a calibration. */
export function Findings({ findings }: { findings: readonly components["schemas"]["FindingResource"][] }) {
  return (
    <>
      {findings.map((finding) => (
        <p key={finding.code} class={`note ${finding.refuses ? "bad" : "warn"}`}>
          {finding.refuses ? "⬣" : "▲"} {sentence(finding.words)}
        </p>
      ))}
    </>
  );
}
