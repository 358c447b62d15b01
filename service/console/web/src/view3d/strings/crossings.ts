import { Group, InstancedMesh, MeshBasicMaterial, Object3D, TorusGeometry, Vector3 } from "three";
import { mm, percent } from "../../texts/format";
import { t } from "../../texts/translate";
import { pointAt } from "./arc_length";
import { label } from "../labels/labels";
import type { Palette } from "../palette";
import { rod } from "../rod";
import { type Crossing, isUncertain, type Model } from "../scene";

/** In string radii: height of a crossing's stem, and radius of the ring around an uncertain crossing. */
const [STEM, RING] = [5, 3.5];
const DASHES = 12;

/** The two strand positions of a crossing, base frame. */
export interface Strands {
  over: Vector3;
  under: Vector3;
  radius_m: number;
}

/** Return the strand positions of a crossing; null if the model has no such strings. */
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

/** Draw a stem through the two strands of each crossing, and a dashed ring around uncertain ones. */
export function drawCrossings(model: Model | null, palette: Palette): Group {
  const group = new Group();
  for (const crossing of model?.crossings ?? []) {
    const strands = model === null ? null : strandsOf(crossing, model);
    if (strands === null) continue;
    const { over, under, radius_m: r } = strands;
    const top = over.clone().add(new Vector3(0, 0, STEM * r));
    const unsure = isUncertain(crossing);
    const colour = unsure ? palette.unsure : palette.ink;
    group.add(rod(under, over, 0.22 * r, colour), rod(over, top, 0.22 * r, colour));
    if (unsure) group.add(dashedRing(over, RING * r, 0.35 * r, palette));
    const text = {
      brief: unsure ? t("viewer.label.uncertain", { id: crossing.id }) : `${crossing.id}`,
      detail: crossingText(crossing),
      kind: unsure ? "crossing unsure" : "crossing",
      target: { kind: "crossing", id: crossing.id } as const,
      rank: 0,
    };
    group.add(label(text, top));
  }
  return group;
}

/** Describe which strand lies over which. */
export function crossingText(crossing: Crossing): string {
  const [over, under] = [crossing.over, crossing.under].map((strand) => {
    const at = mm(strand.s_m, 0);
    return crossing.over.chain === crossing.under.chain ? at : t("viewer.label.at", { id: strand.chain, at });
  });
  const values = { over: over ?? "", under: under ?? "", gap: mm(crossing.gap_m) };
  if (!isUncertain(crossing)) return t("viewer.label.crossing", values);
  return t("viewer.label.crossing_uncertain", { ...values, confidence: percent(crossing.confidence) });
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
