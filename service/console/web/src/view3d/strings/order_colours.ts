/** Viridis from 0.05 to 0.90: increasing brightness, also for colour-blind people and in print. */
export const ORDER_STOPS = [
  "#471365", "#472a7a", "#424186", "#39558c", "#31688e", "#29798e", "#238a8d",
  "#1e9b8a", "#25ac82", "#3fbc73", "#63cb5f", "#8ed645", "#bddf26",
] as const;

/** Return the colours of a string from first to last end as a CSS gradient, for the legend. */
export function orderGradient(): string {
  return `linear-gradient(to right, ${ORDER_STOPS.join(", ")})`;
}
