import { api, longCall, resultOf, type Method, type Scan } from "../net/api";
import { show } from "./scans";
import { refreshNow } from "./updates";

/** Start to recognise the recording of a scan again, and show the new scan. What is omitted is as in the first one. */
export async function recogniseAgain(
  scan: Scan,
  body: { method?: Method; string_radius_m?: number | null } = {},
): Promise<Scan> {
  const created = await resultOf(api.POST("/api/scans/{id}/reprocess", { params: { path: { id: scan.id } }, body, ...longCall }));
  show(created);
  refreshNow();
  return created;
}
