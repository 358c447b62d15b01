import { Matrix4 } from "three";
import type { Pose } from "./scene";

/** A pose of the service's JSON, 4 rows of 4, as three's matrix. */
export function matrixOf(pose: Pose): Matrix4 {
  return new Matrix4().fromArray(pose.flat()).transpose();
}
