import { withinChain } from "./arc_length";
import type { Chain, Model } from "../scene";

/** Part of a chain, by arc length; `to_m` may lie beyond a closed chain's length. */
export interface Piece {
  from_m: number;
  to_m: number;
}

/** Gap of the under strand on either side of a crossing, in string radii, as in a knot diagram ... */
const GAP_RADII = 2.5;
/** ... and longer where the strands cross at a flat angle, down to this sine. */
const LEAST_SINE = 0.3;

/** Split a chain into shown pieces and the gaps where it passes below another strand. */
export function splitAtCrossings(chain: Chain, model: Model): { shown: Piece[]; gaps: Piece[] } {
  const gaps = chain.closed ? cutAtStart(merged(gapsOf(chain, model)), chain.length_m) : merged(gapsOf(chain, model));
  const shown: Piece[] = [];
  let from_m = 0;
  for (const gap of gaps) {
    if (gap.from_m > from_m) shown.push({ from_m, to_m: gap.from_m });
    from_m = Math.max(from_m, gap.to_m);
  }
  if (from_m < chain.length_m) shown.push({ from_m, to_m: chain.length_m });
  return { shown: chain.closed ? joinedAtStart(shown, chain.length_m) : shown, gaps };
}

/** Cut a margin around `places` (arc lengths) out of the pieces of a chain of this length. */
export function cutMargins(
  pieces: readonly Piece[],
  places: readonly number[],
  margin_m: number,
  length_m: number,
): Piece[] {
  const all = [...places, ...places.map((s) => s + length_m)].sort((a, b) => a - b);
  return pieces.flatMap((piece) => {
    const left: Piece[] = [];
    let { from_m } = piece;
    for (const s of all) {
      if (s + margin_m <= from_m || s - margin_m >= piece.to_m) continue;
      if (s - margin_m > from_m) left.push({ from_m, to_m: s - margin_m });
      from_m = s + margin_m;
    }
    return from_m < piece.to_m ? [...left, { from_m, to_m: piece.to_m }] : left;
  });
}

function gapsOf(chain: Chain, model: Model): Piece[] {
  const overs = oversOf(chain, model);
  return model.crossings
    .filter((crossing) => crossing.under.chain === chain.id)
    .map((crossing) => {
      const s = crossing.under.s_m;
      const half = (GAP_RADII * chain.radius_m) / Math.max(Math.sin(crossing.angle_rad), LEAST_SINE);
      // A strand that lies over another one close by stays whole.
      const room = (way: 1 | -1) => Math.min(half, ...overs.map((over) => ahead(chain, s, over, way) / 2));
      return chain.closed
        ? { from_m: s - room(-1), to_m: s + room(1) }
        : { from_m: withinChain(chain, s - room(-1)), to_m: withinChain(chain, s + room(1)) };
    });
}

/** Return where a chain passes above a strand. */
export function oversOf(chain: Chain, model: Model): number[] {
  return model.crossings.filter((one) => one.over.chain === chain.id).map((one) => one.over.s_m);
}

/** Return the distance from `s` to `other` in one direction; infinite if it is not there. */
function ahead(chain: Chain, s: number, other: number, way: 1 | -1): number {
  const apart = (other - s) * way;
  if (chain.closed) return withinChain(chain, apart);
  return apart >= 0 ? apart : Infinity;
}

function merged(pieces: Piece[]): Piece[] {
  const result: Piece[] = [];
  for (const piece of [...pieces].sort((a, b) => a.from_m - b.from_m)) {
    const last = result.at(-1);
    if (last && piece.from_m <= last.to_m) last.to_m = Math.max(last.to_m, piece.to_m);
    else result.push({ ...piece });
  }
  return result;
}

/** Split pieces of a closed chain at its first point. */
function cutAtStart(pieces: Piece[], length_m: number): Piece[] {
  const cut = pieces.flatMap(({ from_m, to_m }) => {
    if (from_m < 0) return [{ from_m: from_m + length_m, to_m: length_m }, { from_m: 0, to_m }];
    if (to_m > length_m) return [{ from_m, to_m: length_m }, { from_m: 0, to_m: to_m - length_m }];
    return [{ from_m, to_m }];
  });
  return merged(cut);
}

/** Join the pieces of a closed chain that meet at its first point. */
function joinedAtStart(pieces: Piece[], length_m: number): Piece[] {
  const [first, last] = [pieces[0], pieces.at(-1)];
  if (!first || !last || first === last || first.from_m > 0 || last.to_m < length_m) return pieces;
  return [...pieces.slice(1, -1), { from_m: last.from_m, to_m: first.to_m + length_m }];
}
