import { useState } from "preact/hooks";
import { api, resultOf, type GraspReach, type Model } from "../net/api";
import type { Failure } from "../ui/action";
import { useQuery } from "../ui/use_query";

/** Number of grasps whose reach is requested. The listed ones are among them. */
const REQUESTED = 20;

/** Whether the arm reaches the first grasps. */
export interface Reach {
  /** By id of the grasp; null values: not determined for this scan. Null: no answer yet. */
  grasps: ReadonlyMap<number, GraspReach | null> | null;
  failure: Failure | null;
}

/** Ask whether the arm reaches the first grasps of a scan; nothing waits for the answer. */
export function useReach(id: string, model: Model): Reach {
  const [grasps, setGrasps] = useState<Reach["grasps"]>(null);
  const known = model.grasps.some(({ T_base_flange }) => T_base_flange !== null);
  const failure = useQuery(
    async () => {
      if (!known) return [];
      const params = { path: { id }, query: { count: REQUESTED } };
      return (await resultOf(api.GET("/api/scans/{id}/grasps", { params }))).grasps;
    },
    (answered) => setGrasps(new Map(answered.map((grasp) => [grasp.id, grasp.reach]))),
    [id, known],
  );
  return { grasps, failure };
}
