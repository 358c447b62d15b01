import { Color } from "three";
import { HEIGHT_STOPS, HIGHEST_M, LOWEST_M } from "./height_colours";

const STOPS = HEIGHT_STOPS.map((stop) => new Color(stop));

/** Return the colour of a height above the table, metres. */
export function colourOfHeight(above_m: number): Color {
  const share = Math.min(Math.max((above_m - LOWEST_M) / (HIGHEST_M - LOWEST_M), 0), 1);
  const at = share * (STOPS.length - 1);
  const from = Math.min(Math.floor(at), STOPS.length - 2);
  return new Color().lerpColors(STOPS[from] ?? new Color(), STOPS[from + 1] ?? new Color(), at - from);
}
