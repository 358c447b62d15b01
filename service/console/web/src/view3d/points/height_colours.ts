/** Cividis: increasing brightness, also for colour-blind people. The pictures of the views have the same colours. */
export const HEIGHT_STOPS = [
  "#00224e", "#003170", "#2a3f6d", "#434e6c", "#575d6d", "#6a6c71", "#7d7c78", "#918b78", "#a59c74", "#bbad6d",
  "#d1bf61", "#e9d34e", "#fee838",
] as const;

/** Heights above the table at the ends of the colours, metres. */
export const [LOWEST_M, HIGHEST_M] = [-0.003, 0.027];

/** Return the colours of heights from `from_m` to the highest as a CSS gradient, for the legend. */
export function heightGradient(from_m: number): string {
  const last = HEIGHT_STOPS.length - 1;
  const heightOf = (index: number) => LOWEST_M + (index / last) * (HIGHEST_M - LOWEST_M);
  const stops = HEIGHT_STOPS.map((stop, index) => `${stop} ${(100 * (heightOf(index) - from_m)) / (HIGHEST_M - from_m)}%`);
  return `linear-gradient(to right, ${stops.join(", ")})`;
}
