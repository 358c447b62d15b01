import { useState } from "preact/hooks";
import { api, resultOf, type Scan } from "../net/api";
import { request } from "../net/request";
import { useQuery } from "../ui/use_query";

const LONG = { fetch: (call: Request) => request(call, 60) };

/** The points of the recorded views of a live scan, in the order of their arrival; the newest view is the last. */
export interface ViewClouds {
  indices: readonly number[];
  clouds: readonly ArrayBuffer[];
}

interface Loaded extends ViewClouds {
  /** ID of their scan. */
  id: string | null;
}

const NOTHING: Loaded = { id: null, indices: [], clouds: [] };

/** Load the points of each view of a live scan as soon as it is recorded, one view at a time. */
export function useViewClouds(scan: Scan | null): ViewClouds {
  const [last, setLast] = useState(NOTHING);
  const id = scan?.mode === "live" ? scan.id : null;
  const loaded = last.id === id ? last : NOTHING;
  const recorded = id === null ? [] : (scan?.progress.views ?? []).filter((view) => view.state === "recorded");
  const next = recorded.find((view) => !loaded.indices.includes(view.index))?.index ?? null;
  useQuery(
    async () => {
      if (id === null || next === null) return null;
      const params = { path: { id, index: next } };
      return resultOf(api.GET("/api/scans/{id}/views/{index}.ply", { params, parseAs: "arrayBuffer", ...LONG }));
    },
    (cloud) => {
      if (cloud === null || next === null) return;
      setLast({ id, indices: [...loaded.indices, next], clouds: [...loaded.clouds, cloud] });
    },
    [id, next],
  );
  return loaded;
}
