import type { Model } from "../../net/api";
import type { Grasp } from "../../view3d/scene";
import type { Reach } from "./use_reach";

/** Number of grasps that are listed and drawn: all of them would hide the strings. */
const LISTED_GRASPS = 5;

/**
 * Return the grasps that are listed and drawn: the best one of each of the first clusters, those that the arm reaches
 * first, and the selected one. Where the reach is known, their flange poses are those of the answer.
 */
export function listedGrasps({ grasps }: Model, reach: Reach["grasps"], selected: number | null): Grasp[] {
  const reached = ({ id }: Grasp) => reach?.get(id)?.reach?.reachable === true;
  const clusters = new Set<number>();
  const listed = [...grasps.filter(reached), ...grasps.filter((one) => !reached(one))]
    .filter(({ cluster }) => !clusters.has(cluster) && clusters.add(cluster))
    .slice(0, LISTED_GRASPS);
  const chosen = listed.some(({ id }) => id === selected) ? undefined : grasps.find(({ id }) => id === selected);
  return [...listed, ...(chosen ? [chosen] : [])].map((one) => {
    const answered = reach?.get(one.id);
    return answered?.reach ? { ...one, T_base_flange: answered.T_base_flange } : one;
  });
}
