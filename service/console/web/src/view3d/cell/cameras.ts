import {
  BufferGeometry, type Color, DoubleSide, Float32BufferAttribute, Group, Line, LineBasicMaterial, LineDashedMaterial,
  LineSegments, Mesh, MeshBasicMaterial, Vector3,
} from "three";
import { t } from "../../texts/translate";
import { linkFrames } from "./kinematics";
import { label } from "../labels/labels";
import type { Palette } from "../palette";
import { matrixOf } from "./pose";
import type { ArmGeometry, CameraPose, Lens, Model, PlannedPath } from "../scene";

/** Length of the drawn part of a camera's field of view. */
const REACH_M = 0.05;
/** The same length for the camera on the arm. */
const SIGHT_M = 0.3;

/** Draw the camera of each view as a pyramid with the view's number. */
export function drawCameras(views: readonly CameraPose[], model: Model | null, palette: Palette): Group {
  const group = new Group();
  for (const view of views) {
    const quality = model?.quality.views.find((one) => one.index === view.index);
    const used = quality?.used ?? true;
    group.add(pyramid(view, used ? palette.ink : palette.unsure));
    const target = { kind: "view", index: view.index } as const;
    const text = { brief: `${view.index}`, kind: used ? "view" : "view unsure", target, rank: 5 };
    group.add(label(used ? text : { ...text, detail: t("viewer.label.view_unused") }, eyeOf(view)));
  }
  return group;
}

/** Draw the planned viewpoints, and the straight lines between them in the order of the path. */
export function drawPlanned(plan: PlannedPath | null, palette: Palette): Group {
  const group = new Group();
  for (const view of plan?.views ?? []) {
    group.add(pyramid(view, palette.muted));
    group.add(label({ brief: `${view.index}`, kind: "view planned", rank: 6 }, eyeOf(view)));
  }
  const path = shapeOf((plan?.path ?? []).map(eyeOf));
  group.add(new Line(path, new LineDashedMaterial({ color: palette.muted, dashSize: 0.01, gapSize: 0.01 })).computeLineDistances());
  return group;
}

/** Draw what the camera on the flange sees, as a pyramid in the frame of the flange. `poseFrustum` moves it. */
export function drawFrustum(lens: Lens | null, palette: Palette): Group {
  const group = new Group();
  if (lens === null) return group;
  return group.add(drawView({ ...lens, T_base_camera: lens.T_flange_camera, index: 0 }, palette.accent, SIGHT_M, 0.15));
}

/** Move the drawn frustum to joint angles. */
export function poseFrustum(group: Group, arm: ArmGeometry, q_rad: readonly number[]): void {
  const flange = linkFrames(arm, q_rad).at(-1);
  if (flange === undefined) return;
  group.matrixAutoUpdate = false;
  group.matrix.copy(flange);
}

/** Draw the pyramid of one view, with its sides filled. */
export function drawView(view: CameraPose, colour: Color, reach_m = 1.5 * REACH_M, opacity = 0.35): Group {
  const group = new Group();
  const [a, b, c, d] = cornersOf(view, reach_m);
  const eye = eyeOf(view);
  if (!a || !b || !c || !d) return group;
  const shape = shapeOf([eye, a, b, eye, b, c, eye, c, d, eye, d, a]);
  const sides = { color: colour, side: DoubleSide, transparent: true, opacity, depthWrite: false };
  group.add(new Mesh(shape, new MeshBasicMaterial(sides)), pyramid(view, colour, reach_m));
  return group;
}

/** Return the camera position of a view. */
export function eyeOf(view: CameraPose): Vector3 {
  return new Vector3().setFromMatrixPosition(matrixOf(view.T_base_camera));
}

function pyramid(view: CameraPose, colour: Color, reach_m = REACH_M): LineSegments {
  const [a, b, c, d] = cornersOf(view, reach_m);
  const eye = eyeOf(view);
  if (!a || !b || !c || !d) return new LineSegments();
  // A peak on the side that is up in the picture.
  const across = b.clone().sub(a);
  const peak = a.clone().addScaledVector(across, 0.5).addScaledVector(a.clone().sub(d), 0.25);
  const lines = [eye, a, eye, b, eye, c, eye, d, a, b, b, c, c, d, d, a, a, peak, peak, b];
  return new LineSegments(shapeOf(lines), new LineBasicMaterial({ color: colour }));
}

/** The picture's corners at a distance: upper left, upper right, lower right, lower left. */
function cornersOf(view: CameraPose, reach_m: number): Vector3[] {
  const [fx, fy] = [view.K[0]?.[0] ?? view.width, view.K[1]?.[1] ?? view.width];
  const [cx, cy] = [view.K[0]?.[2] ?? view.width / 2, view.K[1]?.[2] ?? view.height / 2];
  const pose = matrixOf(view.T_base_camera);
  const pixels: [number, number][] = [[0, 0], [view.width, 0], [view.width, view.height], [0, view.height]];
  return pixels.map(([u, v]) =>
    new Vector3((u - cx) / fx, (v - cy) / fy, 1).multiplyScalar(reach_m).applyMatrix4(pose),
  );
}

function shapeOf(points: readonly Vector3[]): BufferGeometry {
  const shape = new BufferGeometry();
  shape.setAttribute("position", new Float32BufferAttribute(points.flatMap((point) => point.toArray()), 3));
  return shape;
}
