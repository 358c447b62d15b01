import { useEffect, useState } from "preact/hooks";
import { RefusedError } from "../net/api";
import { failureOf, type Failure } from "./action";

/** Pause before a query without an answer is repeated. */
const RETRY_MS = 5000;

/**
 * Send a query when the component is shown and whenever an item of `inputs` changes, and again if no answer came. An
 * answer for earlier inputs is dropped. Return why there is no answer.
 */
export function useQuery<T>(query: () => Promise<T>, answered: (answer: T) => void, inputs: readonly unknown[]): Failure | null {
  const [failure, setFailure] = useState<Failure | null>(null);
  const [tries, setTries] = useState(0);

  useEffect(() => {
    let current = true;
    let timer: ReturnType<typeof setTimeout> | undefined;
    query().then(
      (answer) => {
        if (!current) return;
        setFailure(null);
        answered(answer);
      },
      (error: unknown) => {
        if (!current) return;
        const refused = error instanceof RefusedError && error.problem.status < 500;
        if (!refused) timer = setTimeout(() => setTries((before) => before + 1), RETRY_MS);
        setFailure(failureOf(error));
      },
    );
    return () => {
      current = false;
      clearTimeout(timer);
    };
  }, [...inputs, tries]);
  return failure;
}
