import { Matrix4 } from "three";
import type { Pose } from "../scene";

/** Convert a pose of the service's JSON, 4 rows of 4, to a three.js matrix. */
export function matrixOf(pose: Pose): Matrix4 {
  return new Matrix4().fromArray(pose.flat()).transpose();
}
