import { Badge } from "../bar/status";
import { type Tone, type VerdictCode, verdictWord } from "../texts/states";

const TONES: Record<VerdictCode, Tone> = { accept: "good", warn: "warn", refuse: "bad" };

/** The verdict on a calibration; null: it was never judged. */
export function Verdict({ verdict }: { verdict: VerdictCode | null }) {
  return <Badge tone={verdict === null ? "none" : TONES[verdict]}>{verdictWord(verdict)}</Badge>;
}
