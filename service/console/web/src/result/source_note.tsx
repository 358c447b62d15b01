import { api, resultOf, type Scan } from "../net/api";
import { when } from "../texts/format";
import { problemTitle, slugOf } from "../texts/problem";
import { recordedViews } from "../texts/states";
import { rich, t } from "../texts/translate";
import { strong } from "../ui/action";
import { useLoaded } from "../ui/use_loaded";

/** When the views were taken that were recognised again, and whether their scan was broken off. */
export function SourceNote({ source }: { source: string }) {
  const original = useLoaded(source, true, originalOf);
  if (original === null) return null;
  const { created_at, problem, views, state } = original;
  const time = when(created_at);
  if (problem === null || state === "partial") return <p class="small">{t("result.views_from", { when: time })}</p>;
  const recorded = recordedViews(original);
  const values = {
    when: time,
    reason: problemTitle(slugOf(problem), problem.title),
    views:
      typeof views === "number"
        ? t("scan.progress.views_of", { recorded, total: views })
        : t("scan.progress.views", { count: recorded }),
    strong,
  };
  return <p class="note warn">{rich("result.broken_off", values)}</p>;
}

/** Return the scan of which a scan is a repeated recognition, directly or through others. */
async function originalOf(id: string): Promise<Scan> {
  const scan = await resultOf(api.GET("/api/scans/{id}", { params: { path: { id } } }));
  return scan.source === null ? scan : originalOf(scan.source);
}
