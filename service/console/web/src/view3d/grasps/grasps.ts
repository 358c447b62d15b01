import { BoxGeometry, type Color, Group, InstancedMesh, Matrix4, MeshLambertMaterial, Vector3 } from "three";
import { mm, percent } from "../../texts/format";
import { t } from "../../texts/translate";
import { label } from "../labels/labels";
import type { Palette } from "../palette";
import { matrixOf } from "../cell/pose";
import type { Grasp } from "../scene";

type Bars = InstancedMesh<BoxGeometry, MeshLambertMaterial>;
/** Drawn fingers are slimmer than real ones, to tell neighbouring grasps apart. */
const [THICK_M, WIDE_M, LONG_M] = [0.0007, 0.0018, 0.014];

/** Draw grasps without the selected one: two fingers beside the string and the bar that joins them. */
export function drawGrasps(all: readonly Grasp[], selected: number | null, palette: Palette): Group {
  const group = new Group();
  const grasps = all.filter(({ id }) => id !== selected);
  if (grasps.length === 0) return group;
  group.add(bars(grasps, palette.grasp, { thick: THICK_M, wide: WIDE_M, long: LONG_M }));
  for (const grasp of grasps) {
    const target = { kind: "grasp", id: grasp.id } as const;
    const text = { brief: t("viewer.label.grasp", { index: grasp.id }), kind: "grasp", target, rank: 10 + grasp.id };
    group.add(label(text, handleOf(grasp)));
  }
  return group;
}

/** Draw one grasp whose gripper is not known: two fingers of any size. */
export function drawGrasp(grasp: Grasp, colour: Color): Group {
  const group = new Group();
  const mesh = bars([grasp], colour, { thick: 4 * THICK_M, wide: 4 * WIDE_M, long: 2 * LONG_M });
  mesh.material.transparent = true;
  mesh.material.opacity = 0.7;
  return group.add(mesh);
}

/** Describe a grasp. */
export function graspText(grasp: Grasp): string {
  return t("viewer.label.grasp_detail", { opening: mm(grasp.opening_m), score: percent(grasp.score) });
}

/** Return the middle of the bar behind the fingers of a grasp. */
export function handleOf(grasp: Grasp): Vector3 {
  return new Vector3(0, 0, grasp.reach_m - LONG_M).applyMatrix4(matrixOf(grasp.T_base_grasp));
}

function bars(grasps: readonly Grasp[], colour: Color, size: { thick: number; wide: number; long: number }): Bars {
  const material = new MeshLambertMaterial({ color: colour });
  const mesh = new InstancedMesh(new BoxGeometry(1, 1, 1), material, 3 * grasps.length);
  grasps.forEach((grasp, index) => {
    const pose = matrixOf(grasp.T_base_grasp);
    const beside = (grasp.opening_m + size.thick) / 2;
    const middle = grasp.reach_m - size.long / 2;
    const box = (x: number, z: number, wide: number, high: number) =>
      pose.clone().multiply(new Matrix4().makeTranslation(x, 0, z)).scale(new Vector3(wide, size.wide, high));
    mesh.setMatrixAt(3 * index, box(-beside, middle, size.thick, size.long));
    mesh.setMatrixAt(3 * index + 1, box(beside, middle, size.thick, size.long));
    mesh.setMatrixAt(3 * index + 2, box(0, grasp.reach_m - size.long, 2 * beside + size.thick, size.thick));
  });
  return mesh;
}
