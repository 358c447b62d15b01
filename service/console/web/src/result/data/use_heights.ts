import { useState } from "preact/hooks";
import { api, longCall, resultOf, type Scan } from "../../net/api";
import type { Failure } from "../../ui/action";
import { useQuery } from "../../ui/use_query";
import type { HeightMap } from "../../view3d/scene";

interface Heights {
  /** Null while it is hidden, or not loaded yet. */
  map: HeightMap | null;
  failure: Failure | null;
  show: (shown: boolean) => void;
}

/** Load the height map of a scan as soon as it is shown. */
export function useHeights(scan: Scan | null): Heights {
  const [shown, show] = useState(false);
  const [loaded, setLoaded] = useState<{ id: string; map: HeightMap } | null>(null);
  const id = scan?.links.height_map ? scan.id : null;
  const known = loaded !== null && loaded.id === id;

  async function load(): Promise<void> {
    if (id === null || !shown || known) return;
    const answer = await resultOf(api.GET("/api/scans/{id}/height-map", { params: { path: { id } }, ...longCall }));
    setLoaded({ id, map: answer as HeightMap });
  }

  const failure = useQuery(load, () => undefined, [id, shown]);
  return { map: shown && known ? loaded.map : null, failure: shown ? failure : null, show };
}
