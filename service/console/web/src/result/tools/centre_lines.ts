import type { Model } from "../../net/api";

/** The columns of `pointchain export` to CSV. */
const COLUMNS = ["chain", "point", "x_m", "y_m", "z_m", "arc_length_m", "sigma_m", "views", "radius_m"];

/** Return the centre lines of a model as CSV: a header, and a row for each point. Metres, base frame. */
export function centreLines({ chains }: Model): string {
  const rows = chains.flatMap(({ id, points, arc_length_m, sigma_m, views, radius_m }) =>
    points.map((point, k) => [id, k, ...point, arc_length_m[k], sigma_m[k], views[k], radius_m]),
  );
  return [COLUMNS, ...rows].map((row) => `${row.join(",")}\r\n`).join("");
}
