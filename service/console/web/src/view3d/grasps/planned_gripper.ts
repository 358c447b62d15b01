import type { Grasp, Gripper, Pose } from "../scene";

/** Length from the flange to the fingertips for which flange poses are computed if none is configured, metres. */
const DEFAULT_LENGTH_M = 0.174;
/** Largest differences between two equal poses, which the service rounds. */
const [ROUNDING_M, MIN_COSINE] = [0.0005, 0.9998];

/** Return the distance from the flange to the fingertips, metres. */
export function lengthOf({ length_m }: Gripper): number {
  return length_m ?? DEFAULT_LENGTH_M;
}

/** Return whether the flange poses of a grasp are for a gripper with this length and this rotation on the flange. */
export function isPlannedFor({ T_base_grasp, T_base_flange, reach_m }: Grasp, gripper: Gripper): boolean {
  const flange = T_base_flange.grasp;
  const [cos, sin] = [Math.cos(gripper.mounting_rotation_rad), Math.sin(gripper.mounting_rotation_rad)];
  const [planned, tips] = [ahead(T_base_grasp, reach_m), ahead(flange, lengthOf(gripper))];
  const across = column(flange, 0).map((x, row) => cos * x + sin * (column(flange, 1)[row] ?? 0));
  return (
    Math.hypot(...planned.map((value, row) => value - (tips[row] ?? 0))) < ROUNDING_M &&
    dot(column(flange, 2), column(T_base_grasp, 2)) > MIN_COSINE &&
    // A gripper that is turned by pi about its approach direction holds the string in the same way.
    Math.abs(dot(across, column(T_base_grasp, 0))) > MIN_COSINE
  );
}

/** Return the point at a distance along the z axis of a pose. */
function ahead(pose: Pose, distance_m: number): number[] {
  return column(pose, 3).map((value, row) => value + distance_m * (column(pose, 2)[row] ?? 0));
}

function column(pose: Pose, index: number): number[] {
  return pose.slice(0, 3).map((row) => row[index] ?? 0);
}

function dot(a: readonly number[], b: readonly number[]): number {
  return a.reduce((sum, value, row) => sum + value * (b[row] ?? 0), 0);
}
