import { useState } from "preact/hooks";
import { useQuery } from "./use_query";

/**
 * Load what belongs to an id as soon as it is ready, and keep it as long as the id is the same. Return null before.
 */
export function useLoaded<T>(id: string | null, isReady: boolean, load: (id: string) => Promise<T>): T | null {
  const [loaded, setLoaded] = useState<{ id: string; value: T } | null>(null);
  const wanted = isReady ? id : null;
  useQuery(
    async () => (wanted === null ? null : { id: wanted, value: await load(wanted) }),
    (answer) => answer !== null && setLoaded(answer),
    [wanted],
  );
  return loaded !== null && loaded.id === id ? loaded.value : null;
}
