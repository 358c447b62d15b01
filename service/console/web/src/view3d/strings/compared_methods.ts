import { CapsuleGeometry, Color, Group, InstancedMesh, MeshBasicMaterial, Object3D, Vector3 } from "three";
import { t } from "../../texts/translate";
import { pieceCount, pointAt } from "./arc_length";
import { label } from "../labels/labels";
import { type Chain, EARLIER_LINE, lineOf, type LineStyle, type Model, type Other } from "../scene";
import { directionAt } from "./tubes";

/** Length of a stroke and distance between strokes, in string radii. */
const STROKES: Record<LineStyle, { long: number; step: number }> = {
  solid: { long: 2, step: 1 },
  dashed: { long: 2.5, step: 5 },
  dotted: { long: 0, step: 2.2 },
};
const [CORE, RIM] = [0.35, 0.6];
const RIM_COLOUR = new Color("#10181f");

/** Draw the results of other methods as lines over everything else: light with a dark rim, visible on any background. */
export function drawOthers(others: readonly Other[]): Group {
  const group = new Group();
  for (const { method, model } of others) {
    for (const chain of model.chains) group.add(...line(chain, lineOf(method)));
  }
  return group;
}

/** Draw the strings of an earlier scan, likewise. */
export function drawEarlier(earlier: Model | null): Group {
  const group = new Group();
  for (const chain of earlier?.chains ?? []) {
    const brief = t("viewer.label.earlier_string", { id: chain.id });
    group.add(...line(chain, EARLIER_LINE), label({ brief, kind: "earlier", rank: 6 }, pointAt(chain, 0).point));
  }
  return group;
}

function line(chain: Chain, { style, colour }: { style: LineStyle; colour: string }): InstancedMesh[] {
  return [strokes(chain, style, RIM, RIM_COLOUR, 20), strokes(chain, style, CORE, new Color(colour), 21)];
}

function strokes(chain: Chain, style: LineStyle, thick: number, colour: Color, order: number): InstancedMesh {
  const r = chain.radius_m;
  const { long, step } = STROKES[style];
  const count = Math.max(1, Math.round(chain.length_m / (step * r)));
  const shape = new CapsuleGeometry(thick * r, long * r, 3, 8);
  const mesh = new InstancedMesh(shape, new MeshBasicMaterial({ color: colour, depthTest: false }), count);
  mesh.renderOrder = order;
  const pose = new Object3D();
  for (let index = 0; index < count; index++) {
    const s = ((index + 0.5) / count) * chain.length_m;
    pose.position.fromArray(pointAt(chain, s).point);
    const way = directionAt(chain, s, chain.length_m / pieceCount(chain));
    pose.quaternion.setFromUnitVectors(new Vector3(0, 1, 0), way);
    pose.updateMatrix();
    mesh.setMatrixAt(index, pose.matrix);
  }
  return mesh;
}
