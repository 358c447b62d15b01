import { Vector3 } from "three";
import { capsuleEnds } from "../cell/arm";
import { eyeOf } from "../cell/cameras";
import { workspaceOf } from "../cell/geometry";
import { pointsOfMotion } from "../grasps/grasp_motion";
import type { Content, Layer, Target } from "../scene";

export const UP = new Vector3(0, 0, 1);
/** Viewing directions: an overview, from above with x to the right, and level with the table. */
export const DIRECTIONS = {
  fit: new Vector3(0.25, -0.75, 0.9).normalize(),
  top: new Vector3(0, -1e-4, 1).normalize(),
  side: new Vector3(0, -1, 0.04).normalize(),
};
/** Margin around the content, for labels. */
const MARGIN = 1.15;
const LEAST_M = 0.05;
/** Radius of the drawing around a point. */
const PAD_M = 0.01;
const CLOUD_SAMPLES = 2000;

/** Position and target of a camera. */
export interface Framing {
  position: Vector3;
  target: Vector3;
}

/** Return the nearest position in a direction from which all points are visible; `fov_rad` is the vertical angle. */
export function framing(points: readonly Vector3[], towards: Vector3, fov_rad: number, aspect: number): Framing | null {
  const target = middle(points);
  if (target === null) return null;
  const right = new Vector3().crossVectors(UP, towards).normalize();
  const above = new Vector3().crossVectors(towards, right);
  const half = Math.tan(fov_rad / 2) / MARGIN;
  let distance = LEAST_M;
  for (const point of points) {
    const from = point.clone().sub(target);
    const aside = Math.max((Math.abs(from.dot(right)) + PAD_M) / aspect, Math.abs(from.dot(above)) + PAD_M);
    distance = Math.max(distance, aside / half + from.dot(towards));
  }
  return { position: target.clone().addScaledVector(towards, distance), target };
}

/**
 * Return the points of the overview: strings, cloud or workspace, the selected grasp, and the shown layers around them.
 * The arm is not included while a grasp is selected, because the grasp would be small.
 */
export function pointsToFrame(
  content: Content,
  cloud: Float32Array | null,
  shown: ReadonlySet<Layer>,
  marked: Target | null,
  withArm: boolean,
): Vector3[] {
  const { model, earlier, grasps, gripper, geometry, q_rad, views, planned } = content;
  const chains = [...(model?.chains ?? []), ...(earlier?.chains ?? [])];
  const points = chains.flatMap((chain) => chain.points.map((point) => new Vector3().fromArray(point)));
  if (points.length === 0 && cloud !== null) points.push(...sample(cloud));
  if (points.length === 0 && geometry !== null) points.push(...corners(geometry));
  const grasp = marked?.kind === "grasp" ? grasps.find(({ id }) => id === marked.id) : undefined;
  if (grasp) points.push(...pointsOfMotion(grasp, gripper));
  if (shown.has("cameras")) points.push(...[...views, ...(planned?.path ?? [])].map(eyeOf));
  if (!grasp && withArm && shown.has("arm") && geometry !== null && q_rad !== null) {
    points.push(...capsuleEnds(geometry.arm, q_rad).flatMap(([, ends]) => ends));
  }
  return points;
}

function corners(geometry: NonNullable<Content["geometry"]>): Vector3[] {
  const { min, max } = workspaceOf(geometry);
  return [min, max].flatMap((x) =>
    [min, max].flatMap((y) => [min, max].map((z) => new Vector3(x.x, y.y, z.z))),
  );
}

function sample(cloud: Float32Array): Vector3[] {
  const step = 3 * Math.ceil(cloud.length / 3 / CLOUD_SAMPLES);
  const points: Vector3[] = [];
  for (let at = 0; at + 2 < cloud.length; at += step) points.push(new Vector3().fromArray(cloud, at));
  return points;
}

function middle(points: readonly Vector3[]): Vector3 | null {
  const [first] = points;
  if (!first) return null;
  const [low, high] = [first.clone(), first.clone()];
  for (const point of points) {
    low.min(point);
    high.max(point);
  }
  return low.add(high).multiplyScalar(0.5);
}
