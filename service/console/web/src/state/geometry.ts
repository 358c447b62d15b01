import { signal } from "@preact/signals";
import { api, resultOf, type CellGeometry } from "../net/api";

/** Workspace, arm shape and scan settings, which are constant while the service runs. Null: not requested yet. */
export const geometry = signal<CellGeometry | null>(null);

/** Request them. */
export async function loadGeometry(): Promise<void> {
  const answer: unknown = await resultOf(api.GET("/api/cell/geometry"));
  geometry.value = answer as CellGeometry; // the client types corners as lists of any length
}
