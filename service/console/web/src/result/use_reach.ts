import { useState } from "preact/hooks";
import { api, longCall, resultOf, type GraspReach, type Model } from "../net/api";
import { type Action, type Failure, useAction } from "../ui/action";
import { useQuery } from "../ui/use_query";
import type { Grasp } from "../view3d/scene";

/** The answer about a grasp. */
interface Answered {
  /** Null: not determined. */
  reach: GraspReach | null;
  /** The flange poses. Where the reach was determined, the gripper may be turned by pi about its approach direction. */
  T_base_flange: Grasp["T_base_flange"];
}

/** Whether the arm reaches the grasps. */
export interface Reach {
  /** By id of the grasp. Null: no answer yet. */
  grasps: ReadonlyMap<number, Answered> | null;
  failure: Failure | null;
  /** Whether a person asked for it. */
  requested: boolean;
  /** Asks for the reach by the configured cell, also for a recording. Nothing moves. */
  check: () => Promise<void>;
  checking: Action;
}

/** Ask whether the arm reaches the grasps of a scan; nothing waits for the answer. */
export function useReach(id: string, model: Model | null): Reach {
  const [grasps, setGrasps] = useState<Reach["grasps"]>(null);
  const [requested, setRequested] = useState(false);
  const checking = useAction();
  const known = model === null ? null : model.grasps.some(({ T_base_flange }) => T_base_flange !== null);

  async function ask(query: { reach?: boolean }): Promise<Reach["grasps"]> {
    const call = api.GET("/api/scans/{id}/grasps", { params: { path: { id }, query }, ...longCall });
    return new Map((await resultOf(call)).grasps.map((grasp) => [grasp.id, grasp as Answered & { id: number }]));
  }

  const failure = useQuery(
    async () => {
      if (known === null) return null;
      return known ? ask({}) : new Map();
    },
    setGrasps,
    [id, known],
  );
  async function check(): Promise<void> {
    setGrasps(await ask({ reach: true }));
    setRequested(true);
  }
  return { grasps, failure, requested, check, checking };
}
