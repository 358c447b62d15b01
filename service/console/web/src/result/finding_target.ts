import type { Finding, Model } from "../net/api";
import type { Target, ViewPose } from "../view3d/scene";

/** Return the position of a finding in the 3D view; null if it has none. */
export function findingTarget(finding: Finding, model: Model, views: readonly ViewPose[]): Target | null {
  const { crossing, chains = [], end, s_range_m, point_m, view } = finding;
  if (crossing !== undefined && model.crossings.some(({ id }) => id === crossing)) {
    return { kind: "crossing", id: crossing };
  }
  if (view !== undefined && views.some(({ index }) => index === view)) return { kind: "view", index: view };
  const chain = chains.length === 1 ? model.chains.find(({ id }) => id === chains[0]) : undefined;
  if (chain === undefined) {
    const [x, y, z] = point_m ?? [];
    return x === undefined || y === undefined || z === undefined ? null : { kind: "at", point: [x, y, z] };
  }
  const [from_m, to_m] = s_range_m ?? [];
  if (from_m !== undefined && to_m !== undefined) return { kind: "part", chain: chain.id, from_m, to_m };
  if (end !== undefined) return { kind: "point", chain: chain.id, s_m: end === "first" ? 0 : chain.length_m };
  return { kind: "chain", id: chain.id };
}
