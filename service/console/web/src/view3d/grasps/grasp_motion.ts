import {
  BoxGeometry, type Color, CylinderGeometry, EdgesGeometry, Group, LineBasicMaterial, LineSegments, Matrix4, Mesh,
  MeshLambertMaterial, Vector3,
} from "three";
import { t } from "../../texts/translate";
import { label } from "../labels/labels";
import type { Palette } from "../palette";
import { isPlannedFor, lengthOf } from "./planned_gripper";
import { matrixOf } from "../cell/pose";
import { arrow } from "../rod";
import type { Grasp, Gripper } from "../scene";

const PALM_M = 0.006;
/** The flange of a UR arm, as ISO 9409-1 has it. */
const [FLANGE_RADIUS_M, FLANGE_M] = [0.0315, 0.006];
const [STEM_M, ARROW_M] = [0.0025, 0.0009];
/** Distance of the arrows from the gripper. */
const BESIDE_M = 0.008;
/** Opacity of the fingers at the grasp and elsewhere. The other parts are clearer: they cover the string from above. */
const [SOLID, FAINT] = [0.75, 0.2];
const [OF_PALM, OF_BODY, OF_FLANGE] = [0.35, 0.15, 0.2];
/** Pre-grasp and retreat that are nearer to one another are drawn as one pose. */
const SAME_POSE_M = 0.001;

/** A rectangular box: its centre and its size, in the frame of the gripper. */
interface Box {
  centre: readonly [number, number, number];
  size: readonly [number, number, number];
  /** Opacity relative to the fingers. */
  opacity: number;
}

/** Poses of the gripper's frame, base frame. Its origin is that of the flange, and x is the closing direction. */
interface Motion {
  grasp: Matrix4;
  pregrasp: Matrix4;
  retreat: Matrix4;
}

/**
 * Draw the gripper up to the flange: at the grasp in full, and faint at the pre-grasp (open) and at the retreat
 * (closed), or once (open) where both are the same pose. Arrows show the motions between them. Return null if it
 * is not known.
 */
export function drawMotion(grasp: Grasp, radius_m: number, gripper: Gripper | null, palette: Palette): Group | null {
  const motion = motionOf(grasp, gripper);
  if (gripper === null || motion === null) return null;
  const { opening_m } = grasp;
  const open = boxesOf(gripper, opening_m);
  const group = new Group();
  group.add(
    drawGripper(open, motion.grasp, palette.accent, SOLID),
    drawGripper(open, motion.pregrasp, palette.accent, FAINT),
  );
  const beside = BESIDE_M + Math.max(...open.map(({ centre, size }) => Math.abs(centre[0]) + size[0] / 2));
  const palm = (pose: Matrix4, x: number) => new Vector3(x, 0, palmZ(gripper)).applyMatrix4(pose);
  group.add(
    arrow(palm(motion.pregrasp, beside), palm(motion.grasp, beside), ARROW_M, palette.accent),
    arrow(palm(motion.grasp, -beside), palm(motion.retreat, -beside), ARROW_M, palette.muted),
  );
  // The flange is the part of a faint gripper that the one at the grasp never covers.
  const flangeEdge = (pose: Matrix4, side: number) => new Vector3(side * FLANGE_RADIUS_M, 0, 0).applyMatrix4(pose);
  if (isOnePose(motion)) {
    const brief = t("viewer.label.pregrasp_and_retreat");
    const text = { brief, kind: "motion", rank: 0, around_m: FLANGE_RADIUS_M / 2 };
    return group.add(label(text, positionOf(motion.pregrasp)));
  }
  const closed = boxesOf(gripper, Math.min(2 * radius_m, opening_m));
  return group.add(
    drawGripper(closed, motion.retreat, palette.muted, FAINT),
    label({ brief: t("viewer.label.pregrasp"), kind: "motion", rank: 0 }, flangeEdge(motion.pregrasp, 1)),
    label({ brief: t("viewer.label.retreat"), kind: "motion back", rank: 0 }, flangeEdge(motion.retreat, -1)),
  );
}

/** Return the middle of the palm at the grasp; null if the motion is not known. */
export function palmOf(grasp: Grasp, gripper: Gripper | null): Vector3 | null {
  const motion = motionOf(grasp, gripper);
  return gripper && motion && new Vector3(0, 0, palmZ(gripper)).applyMatrix4(motion.grasp);
}

/** Return corners of the gripper and of its flange at all poses of the motion; none if it is not known. */
export function pointsOfMotion(grasp: Grasp, gripper: Gripper | null): Vector3[] {
  const motion = motionOf(grasp, gripper);
  if (gripper === null || motion === null) return [];
  const signs = [-1, 1];
  const flange = signs.flatMap((x) =>
    signs.map((y) => new Vector3(x * FLANGE_RADIUS_M, y * FLANGE_RADIUS_M, -FLANGE_M)),
  );
  const corners = boxesOf(gripper, grasp.opening_m).flatMap(({ centre, size: [x, y, z] }) =>
    signs.flatMap((i) => signs.flatMap((j) => signs.map((k) =>
      new Vector3((i * x) / 2, (j * y) / 2, (k * z) / 2).add(new Vector3(...centre)),
    ))),
  );
  return [motion.grasp, motion.pregrasp, motion.retreat].flatMap((pose) =>
    [...flange, ...corners].map((point) => point.clone().applyMatrix4(pose)),
  );
}

/** Return the poses of the gripper; null if it is not known, or has another length or rotation on the flange. */
function motionOf(grasp: Grasp, gripper: Gripper | null): Motion | null {
  const { T_base_flange } = grasp;
  if (gripper === null || !isPlannedFor(grasp, gripper)) return null;
  const mounting = new Matrix4().makeRotationZ(gripper.mounting_rotation_rad);
  const poseOf = (T_base: Grasp["T_base_grasp"]) => matrixOf(T_base).multiply(mounting);
  return {
    grasp: poseOf(T_base_flange.grasp),
    pregrasp: poseOf(T_base_flange.pregrasp),
    retreat: poseOf(T_base_flange.retreat),
  };
}

function isOnePose({ pregrasp, retreat }: Motion): boolean {
  return positionOf(pregrasp).distanceTo(positionOf(retreat)) < SAME_POSE_M;
}

/** Return the middle of the drawn palm along the axis of the gripper. */
function palmZ(gripper: Gripper): number {
  return lengthOf(gripper) - gripper.finger_depth_m - PALM_M / 2;
}

/** Return the two fingers at a distance from one another, the palm behind them, and the body up to the flange. */
function boxesOf(gripper: Gripper, apart_m: number): Box[] {
  const { finger_thickness_m: thick, finger_width_m: wide, finger_depth_m: long, stroke_m, palm_width_m } = gripper;
  const beside = (apart_m + thick) / 2;
  const middle = lengthOf(gripper) - long / 2;
  const finger = (x: number): Box => ({ centre: [x, 0, middle], size: [thick, wide, long], opacity: 1 });
  // The planner of the grasps checks a palm that is, across the string, as wide as the fingers at the largest opening.
  const palm: Box = {
    centre: [0, 0, palmZ(gripper)],
    size: [stroke_m + 2 * thick, palm_width_m, PALM_M],
    opacity: OF_PALM,
  };
  const body = gripper.body_m.map(([one, other]): Box => ({
    centre: [(one[0] + other[0]) / 2, (one[1] + other[1]) / 2, (one[2] + other[2]) / 2],
    size: [Math.abs(other[0] - one[0]), Math.abs(other[1] - one[1]), Math.abs(other[2] - one[2])],
    opacity: OF_BODY,
  }));
  // Without a body, a rod stands for what is between palm and flange.
  const back = lengthOf(gripper) - long - PALM_M;
  const stem: Box = { centre: [0, 0, back / 2], size: [2 * STEM_M, 2 * STEM_M, back], opacity: 1 };
  return [finger(-beside), finger(beside), palm, ...(body.length > 0 ? body : [stem])];
}

/** Draw a gripper and the flange behind it. */
function drawGripper(parts: readonly Box[], pose: Matrix4, colour: Color, opacity: number): Group {
  const group = new Group();
  for (const { centre, size, opacity: relative } of parts) {
    const body = translucent(new BoxGeometry(...size), colour, opacity * relative, relative === 1 && opacity === SOLID);
    body.position.set(...centre);
    group.add(body);
  }
  const round = new CylinderGeometry(FLANGE_RADIUS_M, FLANGE_RADIUS_M, FLANGE_M, 32).rotateX(Math.PI / 2);
  const disc = translucent(round, colour, opacity * OF_FLANGE, false);
  disc.position.set(0, 0, -FLANGE_M / 2);
  group.add(disc);
  group.applyMatrix4(pose);
  return group;
}

/** Return a translucent body with its edges. */
function translucent(shape: BoxGeometry | CylinderGeometry, colour: Color, opacity: number, hides: boolean): Mesh {
  const body = new MeshLambertMaterial({ color: colour, transparent: true, opacity, depthWrite: hides });
  const ofEdges = Math.min(1, Math.max(0.25, 4 * opacity));
  const edges = new LineBasicMaterial({ color: colour, transparent: true, opacity: ofEdges });
  const mesh = new Mesh(shape, body);
  return mesh.add(new LineSegments(new EdgesGeometry(shape, 30), edges));
}

function positionOf(pose: Matrix4): Vector3 {
  return new Vector3().setFromMatrixPosition(pose);
}
