import { Vector3 } from "three";
import { pieceCount, vertexAt } from "../strings/arc_length";
import { eyeOf } from "../cell/cameras";
import { strandsOf } from "../strings/crossings";
import { handleOf } from "../grasps/grasps";
import { pickCloud, pickHeights } from "./pick_surface";
import { type Chain, type Content, type Layer, type Target } from "../scene";
import { pixelsAhead, type Screen, type Seen, project } from "../camera/screen";

/** Accuracy of a finger, pixels; less where many targets are close together. */
const [FINGER, NEAR] = [24, 14];

/**
 * Return the target at a point of the canvas: crossings and grasps before strings, strings before cameras, and these
 * before the measured points and heights.
 */
export function pick(
  content: Content,
  cloud: Float32Array | null,
  shown: ReadonlySet<Layer>,
  screen: Screen,
  x: number,
  y: number,
): Target | null {
  const { model, grasps, views, heights } = content;
  const apart = (point: Vector3 | undefined) => {
    const projected = point && project(point, screen);
    return projected && projected.ahead_m > 0 ? Math.hypot(projected.x - x, projected.y - y) : Infinity;
  };
  if (model !== null && shown.has("crossings")) {
    const crossing = nearest(model.crossings, (one) => apart(strandsOf(one, model)?.over), NEAR);
    if (crossing) return { kind: "crossing", id: crossing.id };
  }
  if (shown.has("grasps")) {
    const grasp = nearest(grasps, (one) => apart(handleOf(one)), NEAR);
    if (grasp) return { kind: "grasp", id: grasp.id };
  }
  const found = model !== null && shown.has("strings") ? pickChain(model.chains, screen, x, y) : null;
  if (found) return found;
  const view = shown.has("cameras") ? nearest(views, (one) => apart(eyeOf(one)), FINGER) : null;
  if (view) return { kind: "view", index: view.index };
  const measured = cloud !== null && shown.has("cloud") ? pickCloud(cloud, screen, x, y) : null;
  if (measured) return measured;
  return heights !== null && shown.has("heights") ? pickHeights(heights, screen, x, y) : null;
}

/** Return the nearest candidate within a limit. */
function nearest<T>(all: readonly T[], far: (one: T) => number, limit: number): T | null {
  const found = all.map((one) => ({ one, far: far(one) })).filter((one) => one.far <= limit);
  return found.sort((a, b) => a.far - b.far)[0]?.one ?? null;
}

/** Return the string under the pointer nearest to the camera, else the string nearest to the pointer. */
function pickChain(chains: readonly Chain[], screen: Screen, x: number, y: number): Target | null {
  const perMetre = pixelsAhead(screen);
  const found = chains.flatMap((chain) => {
    const projected = Array.from({ length: pieceCount(chain) + 1 }, (_, k) => {
      const { point, s_m } = vertexAt(chain, k);
      return { point, s_m, at: project(new Vector3().fromArray(point), screen) };
    });
    return projected.slice(1).flatMap((to, k) => {
      const from = projected[k];
      if (!from || from.at.ahead_m <= 0 || to.at.ahead_m <= 0) return [];
      const share = nearestShare(from.at, to.at, x, y);
      const [u, v] = [from.at.x + (to.at.x - from.at.x) * share, from.at.y + (to.at.y - from.at.y) * share];
      const far = Math.hypot(u - x, v - y);
      const ahead_m = from.at.ahead_m + (to.at.ahead_m - from.at.ahead_m) * share;
      const radius = (perMetre * chain.radius_m) / ahead_m;
      const s_m = from.s_m + (to.s_m - from.s_m) * share;
      return far <= Math.max(FINGER, radius) ? [{ chain: chain.id, s_m, far, ahead_m, hit: far <= radius }] : [];
    });
  });
  const hits = found.filter((one) => one.hit);
  // Neighbouring segments of a strand are all hit: the middle one of equal depth counts.
  const front = Math.min(...hits.map((one) => one.ahead_m));
  const strand = hits.filter((one) => one.ahead_m <= front + radiusMetres(chains));
  const best = (strand.length ? strand : found).sort((a, b) => a.far - b.far)[0];
  return best ? { kind: "point", chain: best.chain, s_m: best.s_m } : null;
}

function radiusMetres(chains: readonly Chain[]): number {
  return Math.max(0, ...chains.map((chain) => chain.radius_m));
}

/** Return the fraction of a screen line that is nearest to a pixel. */
function nearestShare(from: Seen, to: Seen, x: number, y: number): number {
  const [dx, dy] = [to.x - from.x, to.y - from.y];
  const long = dx * dx + dy * dy;
  return long > 0 ? Math.min(Math.max(((x - from.x) * dx + (y - from.y) * dy) / long, 0), 1) : 0;
}
