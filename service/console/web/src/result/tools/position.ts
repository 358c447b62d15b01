import type { Model } from "../../net/api";
import { pointText } from "../../texts/format";
import { t } from "../../texts/translate";
import { distance, pointAt } from "../../view3d/strings/arc_length";
import type { Chain, Point, Target } from "../../view3d/scene";

/** A selected position that can be measured and copied. */
export interface Position {
  name: string;
  /** Metres, base frame. */
  point: Point;
  /** Standard deviation, metres; null: not known. */
  sigma_m: number | null;
  /** The string that it is on, if it is on one only. */
  on: { chain: Chain; index: number; s_m: number } | null;
}

/** Return the position of a target; null if the target is not a single position. */
export function positionOf(target: Target, { chains, crossings }: Model): Position | null {
  if (target.kind === "at") {
    const name = t("result.position.measured", { point: pointText(target.point) });
    return { name, point: target.point, sigma_m: null, on: null };
  }
  if (target.kind === "point") {
    const chain = chains.find(({ id }) => id === target.chain);
    return chain === undefined ? null : onString(chain, target.s_m);
  }
  const crossing = target.kind === "crossing" ? crossings.find(({ id }) => id === target.id) : undefined;
  if (crossing === undefined) return null;
  const [x = 0, y = 0, z = 0] = crossing.point;
  const sigmas_m = [crossing.over, crossing.under].map((strand) => {
    const chain = chains.find(({ id }) => id === strand.chain);
    return chain === undefined ? 0 : onString(chain, strand.s_m).sigma_m;
  });
  // The position is the midpoint of both strands.
  const sigma_m = Math.hypot(...sigmas_m) / 2;
  return { name: t("result.position.crossing", { id: crossing.id }), point: [x, y, z], sigma_m, on: null };
}

/** Return the point of the model that is nearest along a string. */
function onString(chain: Chain, at_m: number): Position & { sigma_m: number } {
  const { index } = pointAt(chain, at_m);
  const [x = 0, y = 0, z = 0] = chain.points[index] ?? [];
  const name = t("result.position.string", { string: chain.id, index });
  const on = { chain, index, s_m: chain.arc_length_m[index] ?? 0 };
  return { name, point: [x, y, z], sigma_m: chain.sigma_m[index] ?? 0, on };
}

/** The distance between two positions. */
export interface Measurement {
  distance_m: number;
  /** From the first position to the second one, along x, y and z. */
  difference_m: Point;
  /** Standard deviation of the distance; null: that of a position is not known. */
  sigma_m: number | null;
  /** Length of the string between them, the shortest first: a closed string has two. Empty: they are not on one string. */
  along_m: readonly number[];
}

/** Measure from one position to another. The errors of both are taken as independent. */
export function measure(from: Position, to: Position): Measurement {
  const [a, b] = [from.point, to.point];
  return {
    distance_m: distance(a, b),
    difference_m: [b[0] - a[0], b[1] - a[1], b[2] - a[2]],
    sigma_m: from.sigma_m === null || to.sigma_m === null ? null : Math.hypot(from.sigma_m, to.sigma_m),
    along_m: lengthsBetween(from.on, to.on),
  };
}

function lengthsBetween(from: Position["on"], to: Position["on"]): number[] {
  if (from === null || to === null || from.chain.id !== to.chain.id) return [];
  const direct = Math.abs(to.s_m - from.s_m);
  if (!from.chain.closed) return [direct];
  return [direct, from.chain.length_m - direct].sort((a, b) => a - b);
}

/** Return the second position of a measurement: the selected one, unless it is the first. */
export function measuredTo(from: Position | null, target: Target | null, model: Model | null): Position | null {
  const to = target === null || model === null ? null : positionOf(target, model);
  return to === null || from === null || to.name === from.name ? null : to;
}
