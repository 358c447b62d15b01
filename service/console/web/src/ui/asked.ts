import { useEffect, useState } from "preact/hooks";
import { RefusedError } from "../net/api";
import { failureOf, type Failure } from "./action";

/** Behind an answer that did not come. */
const AGAIN_MS = 5000;

/**
 * Asks when a component is shown and whenever something of `of` changes; again, when no answer came. What was asked
 * for something else by then is not told. Gives why there is no answer.
 */
export function useAsked<T>(ask: () => Promise<T>, answered: (answer: T) => void, of: readonly unknown[]): Failure | null {
  const [failure, setFailure] = useState<Failure | null>(null);
  const [tries, setTries] = useState(0);

  useEffect(() => {
    let current = true;
    let timer: ReturnType<typeof setTimeout> | undefined;
    ask().then(
      (answer) => {
        if (!current) return;
        setFailure(null);
        answered(answer);
      },
      (error: unknown) => {
        if (!current) return;
        const refused = error instanceof RefusedError && error.problem.status < 500;
        if (!refused) timer = setTimeout(() => setTries((before) => before + 1), AGAIN_MS);
        setFailure(failureOf(error));
      },
    );
    return () => {
      current = false;
      clearTimeout(timer);
    };
  }, [...of, tries]);
  return failure;
}
