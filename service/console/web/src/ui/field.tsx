import type { ComponentChild } from "preact";
import { useId } from "preact/hooks";
import { HintButton, HintText, useHint, type Term } from "./hint";

interface FieldProps {
  label: string;
  hint?: Term;
  /** Draws the input, with this id. */
  children: (id: string) => ComponentChild;
}

/** An input below its label, with an optional hint that explains the label. */
export function Field({ label, hint, children }: FieldProps) {
  const id = useId();
  const shown = useHint();
  return (
    <div class="field">
      <div>
        <label for={id}>{label}</label> {hint && <HintButton name={label} shown={shown} />}
      </div>
      {children(id)}
      {hint && <HintText term={hint} shown={shown} />}
    </div>
  );
}
