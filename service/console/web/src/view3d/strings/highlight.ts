import { type Color, Group, Mesh, MeshBasicMaterial, SphereGeometry, TorusGeometry, Vector3 } from "three";
import { mm, pointText } from "../../texts/format";
import { t } from "../../texts/translate";
import { pointAt, withinChain } from "./arc_length";
import { drawView, eyeOf } from "../cell/cameras";
import { crossingText, strandsOf } from "./crossings";
import type { Piece } from "./gaps";
import { drawGrasp, graspText, handleOf } from "../grasps/grasps";
import { drawMotion, palmOf, pointsOfMotion } from "../grasps/grasp_motion";
import { label } from "../labels/labels";
import type { Palette } from "../palette";
import { overEverything } from "../over_everything";
import { matrixOf } from "../cell/pose";
import { arrow, rod } from "../rod";
import type { Chain, ChainChange, Content, Target } from "../scene";
import { directionAt, tube } from "./tubes";

const UP = new Vector3(0, 0, 1);
const RADIUS_M = 0.004;

/** Draw the highlight of a target, over everything else. */
export function drawMark(target: Target | null, content: Content, palette: Palette): Group {
  const group = new Group();
  if (target === null) return group;
  const chain = (id: number) => content.model?.chains.find((one) => one.id === id);
  switch (target.kind) {
    case "point": {
      const one = chain(target.chain);
      if (one) group.add(markPoint(one, target.s_m, palette.accent));
      break;
    }
    case "chain": {
      const one = chain(target.id);
      if (one) group.add(markPiece(one, { from_m: 0, to_m: one.length_m }, palette.accent));
      break;
    }
    case "part": {
      const one = chain(target.chain);
      if (!one) break;
      const { from_m, to_m } = target;
      const [from, to] = [mm(withinChain(one, from_m), 0), mm(withinChain(one, to_m), 0)];
      const text = t("viewer.label.part", { id: one.id, from, to });
      const middle = new Vector3().fromArray(pointAt(one, (from_m + to_m) / 2).point);
      group.add(markPiece(one, target, palette.accent), pin(middle, one.radius_m, palette.accent, text));
      break;
    }
    case "crossing": {
      const one = content.model?.crossings.find((crossing) => crossing.id === target.id);
      const strands = one && content.model ? strandsOf(one, content.model) : null;
      if (!one || !strands) break;
      const ring = onTop(new TorusGeometry(6 * strands.radius_m, 0.5 * strands.radius_m, 8, 40), palette.accent);
      ring.position.copy(strands.over);
      const top = strands.over.clone().addScaledVector(UP, 5 * strands.radius_m);
      group.add(ring, marked(`${one.id}`, crossingText(one), top));
      break;
    }
    case "view": {
      const one = content.views.find((view) => view.index === target.index);
      if (one) group.add(drawView(one, palette.accent), marked(t("viewer.label.view", { index: one.index }), undefined, eyeOf(one)));
      break;
    }
    case "grasp": {
      const one = content.grasps.find((grasp) => grasp.id === target.id);
      if (!one) break;
      const { gripper } = content;
      const motion = drawMotion(one, chain(one.chain)?.radius_m ?? 0, gripper, palette);
      const palm = palmOf(one, gripper);
      const name = t("viewer.label.grasp", { index: one.id });
      if (motion !== null && palm !== null) group.add(motion, marked(name, undefined, palm));
      else group.add(drawGrasp(one, palette.accent), marked(name, graspText(one), handleOf(one)));
      break;
    }
    case "change":
      group.add(markChange(target.change, content, palette));
      break;
    case "at":
      group.add(pin(new Vector3().fromArray(target.point), RADIUS_M, palette.accent, pointText(target.point)));
  }
  return group;
}

/** A target's position, and the radius of the region to show, metres. */
interface Place {
  point: Vector3;
  around_m: number;
  /** Points to show instead of the whole region. */
  outline?: Vector3[];
}

/** Return where a target is; null if there is no such target. */
export function whereIs(target: Target, content: Content): Place | null {
  const spot = (id: number, s_m: number) => {
    const chain = content.model?.chains.find((one) => one.id === id);
    return chain ? { point: new Vector3().fromArray(pointAt(chain, s_m).point), around_m: 10 * chain.radius_m } : null;
  };
  switch (target.kind) {
    case "point":
      return spot(target.chain, target.s_m);
    case "chain": {
      const chain = content.model?.chains.find((one) => one.id === target.id);
      if (!chain) return null;
      const points = chain.points.map((point) => new Vector3().fromArray(point));
      const point = points.reduce((sum, one) => sum.add(one), new Vector3()).divideScalar(points.length || 1);
      return { point, around_m: Math.max(...points.map((one) => one.distanceTo(point))) };
    }
    case "part": {
      const { chain, from_m, to_m } = target;
      const where = spot(chain, (from_m + to_m) / 2);
      return where && { ...where, around_m: Math.max(where.around_m, (to_m - from_m) / 2) };
    }
    case "crossing": {
      const crossing = content.model?.crossings.find((one) => one.id === target.id);
      return crossing ? spot(crossing.over.chain, crossing.over.s_m) : null;
    }
    case "view": {
      const view = content.views.find((one) => one.index === target.index);
      if (!view) return null;
      const [eye, nearby] = [eyeOf(view), content.model?.chains[0]?.points[0]];
      const centre = nearby ? new Vector3().fromArray(nearby) : eye;
      return { point: eye.clone().lerp(centre, 0.5), around_m: 0.05 + eye.distanceTo(centre) / 2 };
    }
    case "grasp": {
      const grasp = content.grasps.find((one) => one.id === target.id);
      return grasp ? { point: handleOf(grasp), around_m: 0.06, outline: pointsOfMotion(grasp, content.gripper) } : null;
    }
    case "change": {
      const points = changedChains(target.change, content).flatMap((one) => one.points);
      const outline = points.map((point) => new Vector3().fromArray(point));
      return outline[0] ? { point: outline[0], around_m: RADIUS_M, outline } : null;
    }
    case "at":
      return { point: new Vector3().fromArray(target.point), around_m: 10 * RADIUS_M };
  }
}

/** Return the chain of a change in this model and in the earlier one, where there is one. */
function changedChains({ chain, before }: ChainChange, { model, earlier }: Content): Chain[] {
  const now = model?.chains.filter(({ id }) => id === chain) ?? [];
  return [...now, ...(earlier?.chains.filter(({ id }) => id === before) ?? [])];
}

/** Mark a string now and before, and its motion by an arrow. */
function markChange(change: ChainChange, content: Content, palette: Palette): Group {
  const group = new Group();
  for (const one of changedChains(change, content)) {
    group.add(markPiece(one, { from_m: 0, to_m: one.length_m }, palette.accent));
  }
  const before = content.earlier?.chains.find(({ id }) => id === change.before);
  if (before === undefined || change.T_now_before === null) return group;
  const from = new Vector3().fromArray(pointAt(before, before.length_m / 2).point);
  const to = from.clone().applyMatrix4(matrixOf(change.T_now_before));
  return group.add(overEverything(arrow(from, to, 0.35 * before.radius_m, palette.accent), 30));
}

function markPoint(chain: Chain, s_m: number, colour: Color): Group {
  const spot = pointAt(chain, s_m);
  const point = new Vector3().fromArray(spot.point);
  const group = pin(point, chain.radius_m, colour, t("viewer.label.at", { id: chain.id, at: mm(spot.s_m) }));
  const ring = onTop(new TorusGeometry(1.6 * chain.radius_m, 0.3 * chain.radius_m, 8, 28), colour);
  ring.position.copy(point);
  ring.quaternion.setFromUnitVectors(UP, directionAt(chain, spot.s_m, chain.radius_m));
  group.add(ring);
  return group;
}

function markPiece(chain: Chain, { from_m, to_m }: Piece, colour: Color): Group {
  const group = new Group();
  const material = new MeshBasicMaterial({ color: colour, transparent: true, opacity: 0.35, depthWrite: false });
  group.add(new Mesh(tube(chain, { from_m, to_m }, 1.9 * chain.radius_m), material));
  return group;
}

/** Draw a needle that stands on a point, with a label at its top. */
function pin(point: Vector3, radius_m: number, colour: Color, text: string): Group {
  const group = new Group();
  const top = point.clone().addScaledVector(UP, 9 * radius_m);
  const needle = rod(point, top, 0.2 * radius_m, colour);
  const head = onTop(new SphereGeometry(0.8 * radius_m, 14, 10), colour);
  head.position.copy(top);
  group.add(needle, head, marked(text, undefined, top));
  return group;
}

function onTop(shape: Mesh["geometry"], colour: Color): Mesh {
  const mesh = new Mesh(shape, new MeshBasicMaterial({ color: colour, depthTest: false }));
  mesh.renderOrder = 30;
  return mesh;
}

function marked(brief: string, detail: string | undefined, at: Vector3) {
  return label({ brief, ...(detail === undefined ? {} : { detail }), kind: "marked", rank: -1 }, at);
}
