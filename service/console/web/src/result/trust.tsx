import type { Verdict } from "../net/api";
import { SHAPES, VERDICT_TONES } from "../texts/states";

/** The style of a button by the verdict on its part of the model; it is that of a finding. */
export const TRUST_CLASSES: Record<Verdict, string> = { accept: "", review: "doubt", refuse: "blocking" };

/** The verdict on a part of the model. */
export function Trust({ verdict, children }: { verdict: Verdict; children: string }) {
  const tone = VERDICT_TONES[verdict];
  return (
    <span class={`trust ${tone}`}>
      <span aria-hidden="true">{SHAPES[tone]}</span> {children}
    </span>
  );
}
