import { BufferAttribute, Color, Curve, TubeGeometry, Vector3 } from "three";
import { pieceCount, pointAt, withinChain } from "./arc_length";
import type { Piece } from "./gaps";
import { orderColour } from "../palette";
import type { Chain } from "../scene";

const SIDES = 10;
/** Limit of the rings of a chain: more would take time without a visible difference. */
const MOST_RINGS = 1200;

/** A piece of a chain's centre line, not smoothed. */
class CentreLine extends Curve<Vector3> {
  /** Directions are averaged over this length on either side, to hide facets. */
  private readonly reach_m: number;

  constructor(
    private readonly chain: Chain,
    private readonly piece: Piece,
  ) {
    super();
    this.reach_m = (0.75 * chain.length_m) / pieceCount(chain);
  }

  override getPoint(share: number, target = new Vector3()): Vector3 {
    return target.fromArray(pointAt(this.chain, this.at(share)).point);
  }

  // The curve parameter is the arc length, so no table is needed.
  override getPointAt(share: number, target = new Vector3()): Vector3 {
    return this.getPoint(share, target);
  }

  override getTangentAt(share: number, target = new Vector3()): Vector3 {
    return target.copy(directionAt(this.chain, this.at(share), this.reach_m));
  }

  private at(share: number): number {
    return this.piece.from_m + share * (this.piece.to_m - this.piece.from_m);
  }
}

/** Return the direction of a chain at `s_m`, averaged over `reach_m` on either side. */
export function directionAt(chain: Chain, s_m: number, reach_m: number): Vector3 {
  const ahead = new Vector3().fromArray(pointAt(chain, s_m + reach_m).point);
  const mean = ahead.sub(new Vector3().fromArray(pointAt(chain, s_m - reach_m).point));
  return mean.lengthSq() > 0 ? mean.normalize() : new Vector3().fromArray(pointAt(chain, s_m).direction);
}

/** Return a tube along a piece of a chain, coloured by order. */
export function tube(chain: Chain, piece: Piece, radius_m: number): TubeGeometry {
  const length = piece.to_m - piece.from_m;
  const share = chain.length_m > 0 ? length / chain.length_m : 1;
  const rings = Math.max(2, Math.ceil(share * Math.min(pieceCount(chain) * 1.5, MOST_RINGS)));
  const whole = chain.closed && share >= 1;
  const geometry = new TubeGeometry(new CentreLine(chain, piece), rings, radius_m, SIDES, whole);
  const colours: number[] = [];
  for (let ring = 0; ring <= rings; ring++) {
    // The last ring of a closed chain repeats the first one, with the last colour.
    const s = piece.from_m + (ring / rings) * length;
    const { r, g, b } = whole ? orderColour(ring / rings) : colourAt(chain, s);
    for (let side = 0; side <= SIDES; side++) colours.push(r, g, b);
  }
  geometry.setAttribute("color", new BufferAttribute(new Float32Array(colours), 3));
  return geometry;
}

/** Return the colour of a chain at `s_m`. */
export function colourAt(chain: Chain, s_m: number): Color {
  return orderColour(chain.length_m > 0 ? withinChain(chain, s_m) / chain.length_m : 0);
}
