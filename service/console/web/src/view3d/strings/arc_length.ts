import type { Chain, Point } from "../scene";

/** A point on a chain's centre line. */
export interface Spot {
  point: Point;
  /** Unit vector towards the last end. */
  direction: Point;
  /** Index of the nearest model point along the chain. */
  index: number;
  /** Arc length from the first point, within the chain. */
  s_m: number;
}

/** Return the point at arc length `s_m`, clamped at the ends of an open chain, wrapped on a closed one. */
export function pointAt(chain: Chain, s_m: number): Spot {
  const s = withinChain(chain, s_m);
  const piece = pieceAt(chain, s);
  const from = vertexAt(chain, piece);
  const to = vertexAt(chain, piece + 1);
  const share = to.s_m > from.s_m ? (s - from.s_m) / (to.s_m - from.s_m) : 0;
  const index = (share < 0.5 ? piece : piece + 1) % chain.points.length;
  return { point: between(from.point, to.point, share), direction: unit(from.point, to.point), index, s_m: s };
}

/** Wrap an arc length on a closed chain, clamp it on an open one. */
export function withinChain(chain: Chain, s_m: number): number {
  const length = chain.length_m;
  if (!chain.closed) return Math.min(Math.max(s_m, 0), length);
  return length > 0 ? ((s_m % length) + length) % length : 0;
}

/** Return the number of segments of the chain. */
export function pieceCount(chain: Chain): number {
  return chain.closed ? chain.points.length : Math.max(chain.points.length - 1, 1);
}

/** Return point and arc length of a segment's start; the index may be one past the last point. */
export function vertexAt(chain: Chain, index: number): { point: Point; s_m: number } {
  const count = chain.points.length;
  const point = chain.points[index % count];
  if (point === undefined) throw new RangeError(`chain ${chain.id} has no points`);
  if (index < count) return { point, s_m: chain.arc_length_m[index] ?? 0 };
  return { point, s_m: chain.length_m };
}

/** Return the segment that contains arc length `s`, by bisection. */
function pieceAt(chain: Chain, s: number): number {
  let low = 0;
  let high = pieceCount(chain) - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if ((chain.arc_length_m[middle] ?? Infinity) <= s) low = middle;
    else high = middle - 1;
  }
  return low;
}

/** Return the point at a fraction of the line between two points. */
export function between(a: Point, b: Point, share: number): Point {
  return [a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share, a[2] + (b[2] - a[2]) * share];
}

/** Return the distance between two points, metres. */
export function distance(a: Point, b: Point): number {
  return Math.hypot(b[0] - a[0], b[1] - a[1], b[2] - a[2]);
}

function unit(a: Point, b: Point): Point {
  const length = distance(a, b);
  return length > 0 ? [(b[0] - a[0]) / length, (b[1] - a[1]) / length, (b[2] - a[2]) / length] : [1, 0, 0];
}
