import type { ComponentChildren } from "preact";
import { useId, useState } from "preact/hooks";
import { t } from "../texts/translate";

/** A term that not everybody knows: `hint.<term>` explains it. */
export type Term =
  | "viewpoint"
  | "string_radius"
  | "reachable"
  | "recording"
  | "drift"
  | "method"
  | "sigma"
  | "crossing"
  | "grasp"
  | "residual"
  | "board_scale"
  | "board"
  | "coverage";

interface HintState {
  id: string;
  open: boolean;
  set(open: boolean): void;
}

/** Return whether a hint is open. */
export function useHint(): HintState {
  const [open, set] = useState(false);
  return { id: useId(), open, set };
}

/** The button that opens and closes a hint. */
export function HintButton({ name, shown }: { name: string; shown: HintState }) {
  return (
    <button
      type="button"
      class="hint"
      aria-expanded={shown.open}
      aria-controls={shown.id}
      aria-label={t("help.what_is", { term: name })}
      onClick={() => shown.set(!shown.open)}
      onKeyDown={(event) => {
        if (event.key === "Escape") shown.set(false);
      }}
    >
      ?
    </button>
  );
}

/** The explanation of a term. */
export function HintText({ term, shown }: { term: Term; shown: HintState }) {
  return (
    <span id={shown.id} class="hint-text" hidden={!shown.open}>
      {t(`hint.${term}`)}
    </span>
  );
}

/** A term with a button that explains it. */
export function Hint({ term, children }: { term: Term; children: string }) {
  const shown = useHint();
  return (
    <span class="hinted">
      {children} <HintButton name={children} shown={shown} />
      <HintText term={term} shown={shown} />
    </span>
  );
}

interface HintedEntryProps {
  term: Term;
  /** The label of the entry. */
  name: string;
  /** Style class of the value. */
  tone?: string;
  children: ComponentChildren;
}

/** An entry of a list of labels and values. The explanation of its label, below both, has the width of the list. */
export function HintedEntry({ term, name, tone = "", children }: HintedEntryProps) {
  const shown = useHint();
  return (
    <>
      <dt>
        {name} <HintButton name={name} shown={shown} />
      </dt>
      <dd class={tone}>{children}</dd>
      <dd class="explanation" hidden={!shown.open}>
        <HintText term={term} shown={shown} />
      </dd>
    </>
  );
}
