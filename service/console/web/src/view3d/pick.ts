import { Vector3 } from "three";
import { knot, pieceCount } from "./along";
import { eyeOf } from "./cameras";
import { strandsOf } from "./crossings";
import { handleOf } from "./grasps";
import { BEST_GRASPS, type Chain, type Content, type Layer, type Place } from "./scene";
import { pixelsAhead, type Screen, type Seen, seenAt } from "./screen";

/** A finger is so exact, pixels; where much lies together less is taken for a hit. */
const [FINGER, NEAR] = [24, 14];

/** What is shown at a point of the canvas: crossings and grasps before strings, strings before cameras. */
export function pick(content: Content, shown: ReadonlySet<Layer>, screen: Screen, x: number, y: number): Place | null {
  const { model, views } = content;
  const apart = (point: Vector3 | undefined) => {
    const seen = point && seenAt(point, screen);
    return seen && seen.ahead_m > 0 ? Math.hypot(seen.x - x, seen.y - y) : Infinity;
  };
  if (model !== null && shown.has("crossings")) {
    const crossing = nearest(model.crossings, (one) => apart(strandsOf(one, model)?.over), NEAR);
    if (crossing) return { kind: "crossing", id: crossing.id };
  }
  if (model !== null && shown.has("grasps")) {
    const grasp = nearest(model.grasps.slice(0, BEST_GRASPS), (one) => apart(handleOf(one)), NEAR);
    if (grasp) return { kind: "grasp", index: model.grasps.indexOf(grasp) };
  }
  const found = model !== null && shown.has("strings") ? pickChain(model.chains, screen, x, y) : null;
  if (found) return found;
  const view = shown.has("cameras") ? nearest(views, (one) => apart(eyeOf(one)), FINGER) : null;
  return view && { kind: "view", index: view.index };
}

/** The one that is the least far, if it is not farther than a limit. */
function nearest<T>(all: readonly T[], far: (one: T) => number, limit: number): T | null {
  const found = all.map((one) => ({ one, far: far(one) })).filter((one) => one.far <= limit);
  return found.sort((a, b) => a.far - b.far)[0]?.one ?? null;
}

/** The string under the pointer that is nearest to the camera; else the one that is nearest to the pointer. */
function pickChain(chains: readonly Chain[], screen: Screen, x: number, y: number): Place | null {
  const perMetre = pixelsAhead(screen);
  const found = chains.flatMap((chain) => {
    const seen = Array.from({ length: pieceCount(chain) + 1 }, (_, k) => {
      const { point, s_m } = knot(chain, k);
      return { point, s_m, at: seenAt(new Vector3().fromArray(point), screen) };
    });
    return seen.slice(1).flatMap((to, k) => {
      const from = seen[k];
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
  // Pieces beside one another on one strand are all hit: of those at the same depth the one in the middle counts.
  const front = Math.min(...hits.map((one) => one.ahead_m));
  const strand = hits.filter((one) => one.ahead_m <= front + radiusOf(chains));
  const best = (strand.length ? strand : found).sort((a, b) => a.far - b.far)[0];
  return best ? { kind: "point", chain: best.chain, s_m: best.s_m } : null;
}

function radiusOf(chains: readonly Chain[]): number {
  return Math.max(0, ...chains.map((chain) => chain.radius_m));
}

/** Which share of a line on the screen is nearest to a pixel. */
function nearestShare(from: Seen, to: Seen, x: number, y: number): number {
  const [dx, dy] = [to.x - from.x, to.y - from.y];
  const long = dx * dx + dy * dy;
  return long > 0 ? Math.min(Math.max(((x - from.x) * dx + (y - from.y) * dy) / long, 0), 1) : 0;
}
