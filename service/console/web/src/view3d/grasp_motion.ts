import {
  BoxGeometry, type Color, CylinderGeometry, EdgesGeometry, Group, LineBasicMaterial, LineSegments, Matrix4, Mesh,
  MeshLambertMaterial, Vector3,
} from "three";
import { t } from "../texts/translate";
import { label } from "./labels";
import type { Palette } from "./palette";
import { matrixOf } from "./pose";
import { arrow, rod } from "./rod";
import type { CellGeometry, Grasp } from "./scene";

/** Sizes of the fingers and the palm where the gripper is not known, metres: those of the default gripper. */
const DEFAULT = { finger_thickness_m: 0.005, finger_width_m: 0.01, finger_depth_m: 0.04, palm_width_m: 0.075 };
const PALM_M = 0.006;
/** The flange of a UR arm, as ISO 9409-1 has it. */
const [FLANGE_RADIUS_M, FLANGE_M] = [0.0315, 0.006];
const [STEM_M, ARROW_M] = [0.0025, 0.0009];
/** Distance of the arrows from the palm. */
const BESIDE_M = 0.008;
/** Opacity of the fingers at the grasp and elsewhere. Palm and flange are clearer: from above, they cover the string. */
const [SOLID, FAINT] = [0.75, 0.2];
const [OF_PALM, OF_FLANGE] = [0.6, 0.25];

/** A rectangular box: its centre and its size in the frame of the grasp. */
type Box = readonly [centre: readonly [number, number, number], size: readonly [number, number, number]];

/**
 * Draw the gripper up to the flange, at the grasp in full, and faint at the pre-grasp (open) and at the retreat (closed).
 * Arrows show the motions between them. Return null if the flange poses are not known.
 */
export function drawMotion(grasp: Grasp, radius_m: number, geometry: CellGeometry | null, palette: Palette): Group | null {
  const poses = posesOf(grasp);
  if (poses === null) return null;
  const gripper = geometry?.gripper ?? DEFAULT;
  const { opening_m, reach_m } = grasp;
  const closed_m = Math.min(2 * radius_m, opening_m);
  const palm_m = Math.max(gripper.palm_width_m, opening_m + 2 * gripper.finger_thickness_m);
  const group = new Group();
  group.add(
    drawGripper(boxes(grasp, opening_m, gripper, palm_m), poses.grasp, poses.flange, palette.accent, SOLID),
    drawGripper(boxes(grasp, opening_m, gripper, palm_m), poses.pregrasp, poses.flange, palette.accent, FAINT),
    drawGripper(boxes(grasp, closed_m, gripper, palm_m), poses.retreat, poses.flange, palette.muted, FAINT),
  );
  const palm = (pose: Matrix4, x: number) =>
    new Vector3(x, 0, reach_m - gripper.finger_depth_m - PALM_M / 2).applyMatrix4(pose);
  const beside = palm_m / 2 + BESIDE_M;
  group.add(
    arrow(palm(poses.pregrasp, beside), palm(poses.grasp, beside), ARROW_M, palette.accent),
    arrow(palm(poses.grasp, -beside), palm(poses.retreat, -beside), ARROW_M, palette.muted),
    label({ brief: t("viewer.label.pregrasp"), kind: "motion", rank: 0 }, palm(poses.pregrasp, beside)),
    label({ brief: t("viewer.label.retreat"), kind: "motion back", rank: 0 }, palm(poses.retreat, -beside)),
  );
  return group;
}

/** Return the middle of the palm at the grasp. */
export function palmOf({ reach_m, T_base_grasp }: Grasp, geometry: CellGeometry | null): Vector3 {
  const { finger_depth_m } = geometry?.gripper ?? DEFAULT;
  return new Vector3(0, 0, reach_m - finger_depth_m - PALM_M / 2).applyMatrix4(matrixOf(T_base_grasp));
}

/** Return the middle of a motion, and the radius around it that contains its fingers; null without flange poses. */
export function fingersOfMotion(grasp: Grasp): { point: Vector3; around_m: number } | null {
  const poses = posesOf(grasp);
  if (poses === null) return null;
  const { reach_m } = grasp;
  const behind = new Vector3(0, 0, reach_m - DEFAULT.finger_depth_m - PALM_M);
  const tip = new Vector3(0, 0, reach_m).applyMatrix4(poses.grasp);
  const back = farthest(tip, [behind.clone().applyMatrix4(poses.pregrasp), behind.applyMatrix4(poses.retreat)]);
  return { point: tip.clone().lerp(back, 0.5), around_m: tip.distanceTo(back) / 2 };
}

/** Return the points between which the gripper and the flange move; empty without flange poses. */
export function pointsOfMotion(grasp: Grasp): Vector3[] {
  const poses = posesOf(grasp);
  if (poses === null) return [];
  const tip = new Vector3(0, 0, grasp.reach_m).applyMatrix4(poses.grasp);
  const flanges = [poses.pregrasp, poses.retreat].map((pose) => positionOf(pose.clone().multiply(poses.flange)));
  return [tip, farthest(tip, flanges)];
}

function farthest(from: Vector3, points: readonly Vector3[]): Vector3 {
  return points.reduce((far, point) => (from.distanceTo(point) > from.distanceTo(far) ? point : far), from);
}

/** Return the poses of the grasp's frame during the motion, base frame, and the pose of the flange in that frame. */
function posesOf({ T_base_grasp, T_base_flange }: Grasp) {
  if (T_base_flange === null) return null;
  const grasp = matrixOf(T_base_grasp);
  const flange = grasp.clone().invert().multiply(matrixOf(T_base_flange.grasp));
  const back = flange.clone().invert();
  const poseOf = (T_base: Grasp["T_base_grasp"]) => matrixOf(T_base).multiply(back);
  return { grasp, flange, pregrasp: poseOf(T_base_flange.pregrasp), retreat: poseOf(T_base_flange.retreat) };
}

/** Return the two fingers at a distance from one another, and the palm behind them. */
function boxes({ reach_m }: Grasp, apart_m: number, gripper: typeof DEFAULT, palm_m: number): Box[] {
  const { finger_thickness_m: thick, finger_width_m: wide, finger_depth_m: long } = gripper;
  const beside = (apart_m + thick) / 2;
  const finger = (x: number): Box => [[x, 0, reach_m - long / 2], [thick, wide, long]];
  return [finger(-beside), finger(beside), [[0, 0, reach_m - long - PALM_M / 2], [palm_m, 1.5 * wide, PALM_M]]];
}

/** Draw a gripper and the flange behind it, in a pose of the grasp's frame. */
function drawGripper(parts: readonly Box[], pose: Matrix4, flange: Matrix4, colour: Color, opacity: number): Group {
  const group = new Group();
  parts.forEach(([centre, size], index) => {
    const isPalm = index === parts.length - 1;
    const body = translucent(new BoxGeometry(...size), colour, opacity * (isPalm ? OF_PALM : 1));
    body.position.set(...centre);
    group.add(body);
  });
  const round = new CylinderGeometry(FLANGE_RADIUS_M, FLANGE_RADIUS_M, FLANGE_M, 32).rotateX(Math.PI / 2);
  const disc = translucent(round, colour, opacity * OF_FLANGE);
  disc.applyMatrix4(flange.clone().multiply(new Matrix4().makeTranslation(0, 0, -FLANGE_M / 2)));
  const back = parts.at(-1)?.[0] ?? [0, 0, 0];
  const stem = rod(new Vector3(...back), positionOf(flange), STEM_M, colour);
  Object.assign(stem.material, { transparent: true, opacity, depthWrite: false });
  group.add(disc, stem);
  group.applyMatrix4(pose);
  return group;
}

/** Return a translucent body with its edges. */
function translucent(shape: BoxGeometry | CylinderGeometry, colour: Color, opacity: number): Mesh {
  const body = new MeshLambertMaterial({ color: colour, transparent: true, opacity, depthWrite: opacity === SOLID });
  const edges = new LineBasicMaterial({ color: colour, transparent: true, opacity: Math.min(1, Math.max(0.5, 4 * opacity)) });
  const mesh = new Mesh(shape, body);
  return mesh.add(new LineSegments(new EdgesGeometry(shape, 30), edges));
}

function positionOf(pose: Matrix4): Vector3 {
  return new Vector3().setFromMatrixPosition(pose);
}
