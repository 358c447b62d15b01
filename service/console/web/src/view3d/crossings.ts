import { Group, InstancedMesh, MeshBasicMaterial, Object3D, TorusGeometry, Vector3 } from "three";
import { mm, percent } from "../words/units";
import { pointAt } from "./along";
import { label } from "./labels";
import type { Palette } from "./palette";
import { rod } from "./rod";
import { type Crossing, isUnsure, type Model } from "./scene";

/** In radii of the string: how far a crossing's stem stands out above, and the ring round one that is not certain. */
const [STEM, RING] = [5, 3.5];
const DASHES = 12;

/** A crossing's two places, base frame. */
export interface Strands {
  over: Vector3;
  under: Vector3;
  radius_m: number;
}

/** Where a crossing's strands are; null when the model has no such strings. */
export function strandsOf(crossing: Crossing, model: Model): Strands | null {
  const over = model.chains.find((chain) => chain.id === crossing.over.chain);
  const under = model.chains.find((chain) => chain.id === crossing.under.chain);
  if (!over || !under) return null;
  return {
    over: new Vector3().fromArray(pointAt(over, crossing.over.s_m).point),
    under: new Vector3().fromArray(pointAt(under, crossing.under.s_m).point),
    radius_m: Math.max(over.radius_m, under.radius_m),
  };
}

/** Crossings: a stem between the two strands and up to the label; a dashed ring round those that are not certain. */
export function drawCrossings(model: Model | null, palette: Palette): Group {
  const group = new Group();
  for (const crossing of model?.crossings ?? []) {
    const strands = model === null ? null : strandsOf(crossing, model);
    if (strands === null) continue;
    const { over, under, radius_m: r } = strands;
    const top = over.clone().add(new Vector3(0, 0, STEM * r));
    const unsure = isUnsure(crossing);
    const colour = unsure ? palette.unsure : palette.ink;
    group.add(rod(under, over, 0.22 * r, colour), rod(over, top, 0.22 * r, colour));
    if (unsure) group.add(dashedRing(over, RING * r, 0.35 * r, palette));
    const text = {
      brief: `${crossing.id}${unsure ? " ?" : ""}`,
      detail: crossingWords(crossing),
      kind: unsure ? "crossing unsure" : "crossing",
      place: { kind: "crossing", id: crossing.id } as const,
      rank: 0,
    };
    group.add(label(text, top));
  }
  return group;
}

/** What lies over what, in words. */
export function crossingWords(crossing: Crossing): string {
  const [over, under] = [crossing.over, crossing.under].map((strand) => {
    const name = crossing.over.chain === crossing.under.chain ? "" : `string ${strand.chain} at `;
    return name + mm(strand.s_m, 0);
  });
  const sure = isUnsure(crossing) ? `, not certain: ${percent(crossing.confidence)}` : "";
  return `over ${over} / under ${under}, gap ${mm(crossing.gap_m)}${sure}`;
}

function dashedRing(centre: Vector3, radius_m: number, thick_m: number, palette: Palette): InstancedMesh {
  const dash = new TorusGeometry(radius_m, thick_m, 6, 5, (0.6 * 2 * Math.PI) / DASHES);
  const ring = new InstancedMesh(dash, new MeshBasicMaterial({ color: palette.unsure }), DASHES);
  const pose = new Object3D();
  pose.position.copy(centre);
  for (let index = 0; index < DASHES; index++) {
    pose.rotation.z = (index * 2 * Math.PI) / DASHES;
    pose.updateMatrix();
    ring.setMatrixAt(index, pose.matrix);
  }
  return ring;
}
