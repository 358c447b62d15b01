import { Badge } from "../bar/status";
import { VERDICTS, type Look } from "../words/states";

type Judged = keyof typeof VERDICTS;

const LOOKS: Record<Judged, Look> = { accept: "good", warn: "warn", refuse: "bad" };

/** What is thought of a calibration; null: it was never judged. */
export function Verdict({ verdict }: { verdict: Judged | null }) {
  if (verdict === null) return <Badge look="none">not judged</Badge>;
  return <Badge look={LOOKS[verdict]}>{VERDICTS[verdict]}</Badge>;
}
