import type { ComponentChildren } from "preact";
import { useState } from "preact/hooks";
import { RefusedError } from "../net/api";
import { GivenUpError, LostError } from "../net/request";
import { lost } from "../state/freshness";
import { sentence } from "../words/sentence";
import { WhatToDo } from "./manual";

/** Why something came to nothing, for people. */
export interface Failure {
  title: string;
  detail: string;
  slug: string;
  /** The service's problem type; null: the service named none. */
  problem: string | null;
  retryAfter_s: number | null;
}

/** An error as it is told; what nobody has foreseen is thrown on. */
export function failureOf(error: unknown): Failure {
  if (error instanceof RefusedError) {
    const { title, detail, type } = error.problem;
    return { title, detail, slug: error.slug, problem: type, retryAfter_s: error.retryAfter_s };
  }
  if (error instanceof LostError) {
    const detail = `${error.message}: whether it was done is not known. Look at the state above, then try again.`;
    return { title: "The service did not answer", detail, slug: "lost", problem: null, retryAfter_s: null };
  }
  if (error instanceof GivenUpError) {
    const detail = "Stop was pressed meanwhile.";
    return { title: "Given up", detail, slug: "given-up", problem: null, retryAfter_s: null };
  }
  throw error;
}

/** Something that a button does: one at a time, with its failure until the next try. */
export interface Action {
  busy: boolean;
  failure: Failure | null;
  run(work: () => Promise<void>): Promise<void>;
  forget(): void;
}

/** An action of a component's own. */
export function useAction(): Action {
  const [busy, setBusy] = useState(false);
  const [failure, setFailure] = useState<Failure | null>(null);
  return {
    busy,
    failure,
    forget: () => setFailure(null),
    async run(work) {
      setBusy(true);
      setFailure(null);
      try {
        await work();
      } catch (error) {
        setFailure(failureOf(error));
      } finally {
        setBusy(false);
      }
    },
  };
}

interface ActProps {
  action: Action;
  work: () => Promise<void>;
  children: ComponentChildren;
  /** What is said while it goes on. */
  doing?: string;
  kind?: "main" | "plain";
  big?: boolean;
  disabled?: boolean;
}

/** A button that asks the service for something: not while what is shown is old, nor twice at a time. */
export function Act({ action, work, children, doing, kind = "plain", big = false, disabled = false }: ActProps) {
  return (
    <button
      type="button"
      class={big ? `${kind} big` : kind}
      disabled={disabled || action.busy || lost.value}
      onClick={() => void action.run(work)}
    >
      {action.busy && doing !== undefined ? doing : children}
    </button>
  );
}

/** What came of an action, if it came to nothing. */
export function Failed({ failure }: { failure: Failure | null }) {
  return (
    <div role="alert">
      {failure && (
        <p class="note bad">
          <strong>{failure.title}.</strong> {sentence(failure.detail)} <WhatToDo problem={failure.problem} />
        </p>
      )}
    </div>
  );
}
