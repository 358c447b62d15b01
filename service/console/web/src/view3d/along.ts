import type { Chain, Point } from "./scene";

/** A place on a chain's centre line. */
export interface Spot {
  point: Point;
  /** Unit vector towards the last end. */
  direction: Point;
  /** Of the model's point that is nearest along the chain. */
  index: number;
  /** From the first point; within the chain. */
  s_m: number;
}

/** The place at arc length `s_m`; beyond an end it is that end, round a closed chain it goes on. */
export function pointAt(chain: Chain, s_m: number): Spot {
  const s = withinChain(chain, s_m);
  const piece = pieceAt(chain, s);
  const from = knot(chain, piece);
  const to = knot(chain, piece + 1);
  const share = to.s_m > from.s_m ? (s - from.s_m) / (to.s_m - from.s_m) : 0;
  const index = (share < 0.5 ? piece : piece + 1) % chain.points.length;
  return { point: between(from.point, to.point, share), direction: unit(from.point, to.point), index, s_m: s };
}

/** An arc length as one of the chain: closed ones wrap, open ones end. */
export function withinChain(chain: Chain, s_m: number): number {
  const length = chain.length_m;
  if (!chain.closed) return Math.min(Math.max(s_m, 0), length);
  return length > 0 ? ((s_m % length) + length) % length : 0;
}

/** How many straight pieces the chain has. */
export function pieceCount(chain: Chain): number {
  return chain.closed ? chain.points.length : Math.max(chain.points.length - 1, 1);
}

/** Point and arc length of a piece's start; the index may be one past the last point. */
export function knot(chain: Chain, index: number): { point: Point; s_m: number } {
  const count = chain.points.length;
  const point = chain.points[index % count];
  if (point === undefined) throw new RangeError(`chain ${chain.id} has no points`);
  if (index < count) return { point, s_m: chain.arc_length_m[index] ?? 0 };
  return { point, s_m: chain.length_m };
}

/** Which piece holds arc length `s`, by halving. */
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

/** The point at a share of the way from one to another. */
export function between(a: Point, b: Point, share: number): Point {
  return [a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share, a[2] + (b[2] - a[2]) * share];
}

/** Metres from one point to another. */
export function distance(a: Point, b: Point): number {
  return Math.hypot(b[0] - a[0], b[1] - a[1], b[2] - a[2]);
}

function unit(a: Point, b: Point): Point {
  const length = distance(a, b);
  return length > 0 ? [(b[0] - a[0]) / length, (b[1] - a[1]) / length, (b[2] - a[2]) / length] : [1, 0, 0];
}
