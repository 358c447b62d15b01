import type { Grasp } from "../../view3d/scene";

/** Members that the grasps of an earlier release do not have, besides `id` and `cluster`. */
const MISSING = {
  sigma_m: null,
  end_distance_m: null,
  over_distance_m: null,
  under_distance_m: null,
  chains_above: [],
  object_above_m: null,
  T_base_flange: null,
} satisfies Partial<Grasp>;

/** The members that all grasps have. */
type Members = "chain" | "s_m" | "T_base_grasp" | "opening_m" | "reach_m" | "clearance_m" | "table_clearance_m" | "score" | "trusted";
/** A grasp as this or an earlier release stored it. */
export type EarlierGrasp = Pick<Grasp, Members> & Partial<Grasp>;

/** Give grasps the members that an earlier release did not store: each its index as id and as cluster. */
export function completeGrasps(grasps: readonly EarlierGrasp[]): Grasp[] {
  return grasps.map((grasp, index) => ({ ...MISSING, id: index, cluster: index, ...grasp }));
}
