import { api, resultOf, type Scan } from "../../net/api";
import { hasModel, isElsewhere } from "../../texts/states";

/** Number of scans that are searched for earlier ones of the same cell. */
const SEARCHED = 100;

/**
 * Return the earlier scans with a model that may show the same table, the newest first. A live scan is compared with
 * live scans of this cell, and a recording that a person chose with other such recordings. Repeated recognitions are
 * excluded, because they show the table at the time of another scan.
 */
export async function earlierScans(scan: Scan): Promise<Scan[]> {
  const original = await originalOf(scan);
  const query = { state: ["succeeded", "partial"] as Scan["state"][], created_before: original.created_at, limit: SEARCHED };
  const { scans } = await resultOf(api.GET("/api/scans", { params: { query } }));
  return scans.filter(
    (one) =>
      hasModel(one) &&
      one.source === null &&
      one.id !== original.id &&
      one.recording !== scan.recording &&
      isElsewhere(one) === isElsewhere(original) &&
      one.simulated === original.simulated,
  );
}

/** Return the scan that a repeated recognition recognised again; the scan itself if it is none, or if that was removed. */
async function originalOf(scan: Scan): Promise<Scan> {
  if (scan.source === null || scan.recording === null) return scan;
  const { scans } = await resultOf(api.GET("/api/scans", { params: { query: { recording: scan.recording } } }));
  return scans.find((one) => one.source === null) ?? scan;
}
