import { useId, useState } from "preact/hooks";
import hints from "../words/hints.json";

/** A word of ours that not everybody knows. */
export type Term = keyof typeof hints;

interface Shown {
  id: string;
  open: boolean;
  set(open: boolean): void;
}

/** Whether a hint is open. */
export function useHint(): Shown {
  const [open, set] = useState(false);
  return { id: useId(), open, set };
}

/** Opens and closes a hint. */
export function HintButton({ name, shown }: { name: string; shown: Shown }) {
  return (
    <button
      type="button"
      class="hint"
      aria-expanded={shown.open}
      aria-controls={shown.id}
      aria-label={`What is: ${name}?`}
      onClick={() => shown.set(!shown.open)}
      onKeyDown={(event) => {
        if (event.key === "Escape") shown.set(false);
      }}
    >
      ?
    </button>
  );
}

/** What a term means. */
export function HintText({ term, shown }: { term: Term; shown: Shown }) {
  return (
    <span id={shown.id} class="hint-text" hidden={!shown.open}>
      {hints[term]}
    </span>
  );
}

/** A term with a button beside it that says what it means. */
export function Hint({ term, children }: { term: Term; children?: string }) {
  const shown = useHint();
  const name = children ?? term;
  return (
    <span class="hinted">
      {name} <HintButton name={name} shown={shown} />
      <HintText term={term} shown={shown} />
    </span>
  );
}
