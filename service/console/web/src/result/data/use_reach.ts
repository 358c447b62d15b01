import { useState } from "preact/hooks";
import { api, longCall, resultOf, type GraspReach, type Model } from "../../net/api";
import { type Action, type Failure, useAction } from "../../ui/action";
import { useQuery } from "../../ui/use_query";
import type { Grasp } from "../../view3d/scene";

/** The joint angles of the pre-grasp and the grasp; null: the arm does not reach them. */
interface JointAngles {
  q_pregrasp_rad: readonly number[] | null;
  q_grasp_rad: readonly number[] | null;
}

/** The answer about a grasp. */
interface Answered {
  /** Null: not determined. */
  reach: (GraspReach & JointAngles) | null;
  /** The flange poses. Where the reach was determined, the gripper may be turned by pi about its approach direction. */
  T_base_flange: Grasp["T_base_flange"];
}

/** Whether the arm reaches the grasps. */
export interface Reach {
  /** By id of the grasp. Null: no answer yet. */
  grasps: ReadonlyMap<number, Answered> | null;
  /** Whether the grasps are for the gripper that is configured now. Null: not known. */
  sameGripper: boolean | null;
  failure: Failure | null;
  /** Asks for the reach by the configured cell, also for a recording. Nothing moves. */
  check: () => Promise<void>;
  checking: Action;
}

type Known = Pick<Reach, "grasps" | "sameGripper">;
const NOTHING: Known = { grasps: null, sameGripper: null };

/** Ask whether the arm reaches the grasps of a scan; nothing waits for the answer. */
export function useReach(id: string, model: Model | null): Reach {
  const [answer, setAnswer] = useState(NOTHING);
  const checking = useAction();
  const hasGrasps = model === null ? null : model.grasps.length > 0;

  async function ask(query: { reach?: boolean }): Promise<Known> {
    const call = api.GET("/api/scans/{id}/grasps", { params: { path: { id }, query }, ...longCall });
    const { grasps, same_gripper: sameGripper } = await resultOf(call);
    const answered: unknown = grasps; // the client types poses as lists of any length
    const byId = (answered as (Answered & { id: number })[]).map((grasp) => [grasp.id, grasp] as const);
    return { grasps: new Map(byId), sameGripper };
  }

  const failure = useQuery(
    async () => {
      if (hasGrasps === null) return NOTHING;
      return hasGrasps ? ask({}) : { ...NOTHING, grasps: new Map() };
    },
    setAnswer,
    [id, hasGrasps],
  );
  async function check(): Promise<void> {
    setAnswer(await ask({ reach: true }));
  }
  return { ...answer, failure, check, checking };
}
