import { useMemo } from "preact/hooks";
import { Badge } from "../bar/status";
import { api, longCall, resultOf, type Scan } from "../net/api";
import { cell } from "../state/cell";
import { lost, now } from "../state/freshness";
import { show } from "../state/scans";
import { percent } from "../texts/format";
import { SCAN_TONES, scanWord } from "../texts/states";
import { t } from "../texts/translate";
import { Act, Failed, useAction } from "../ui/action";
import { Views } from "./views";

/** A scan that runs. */
export function Progress({ scan }: { scan: Scan }) {
  const action = useAction();
  const activity = activityText(scan);
  const { fraction, elapsed_s, remaining_s } = scan.progress;
  const received = useMemo(() => performance.now(), [scan]);
  const since_s = Math.max(0, (now.value - received) / 1000);
  const elapsed = elapsed_s === null ? null : elapsed_s + since_s;
  const remaining = remaining_s === null ? null : Math.max(0, remaining_s - since_s);
  const done = elapsed === null || remaining === null ? fraction : Math.min(0.99, elapsed / (elapsed + remaining));
  return (
    <section class="panel" aria-label={t("scan.progress.region")}>
      <h2>
        <Badge tone={lost.value ? "none" : SCAN_TONES[scan.state]}>
          {lost.value ? t("scan.progress.unknown", { activity }) : activity}
        </Badge>
      </h2>
      <div class="done">
        <progress max={1} value={done} aria-label={t("common.progress")} />
        <span>{percent(done)}</span>
      </div>
      {elapsed !== null && remaining !== null && (
        <p class="small">
          {t("scan.progress.time", { elapsed: Math.round(elapsed), remaining: Math.ceil(remaining) })}
        </p>
      )}
      {scan.requested_by !== null && <p class="small">{t("scan.progress.started_by", { name: scan.requested_by })}</p>}
      <Act
        action={action}
        disabled={scan.links.cancel === null || scan.state === "stopping"}
        doing={t("common.stopping")}
        work={async () => {
          const params = { path: { id: scan.id } };
          show(await resultOf(api.POST("/api/scans/{id}/cancel", { params, ...longCall })));
        }}
      >
        {scan.mode === "live" ? t("scan.progress.cancel_live") : t("scan.progress.cancel")}
      </Act>
      <Failed failure={action.failure} />
      {scan.mode === "live" && <Views scan={scan} planned={plannedViews(scan)} />}
    </section>
  );
}

/** Return the viewpoints of the cell's plan that the arm has not reached yet. */
function plannedViews(scan: Scan): number[] {
  const plan = cell.value?.viewpoints;
  if (!plan || !["preflight", "scanning"].includes(scan.state)) return [];
  const known = new Set([...scan.progress.views, ...plan.unreachable].map((view) => view.index));
  return Array.from({ length: plan.planned }, (_, index) => index).filter((index) => !known.has(index));
}

/** Return what the scan does now. The bar announces a change to screen readers. */
function activityText(scan: Scan): string {
  if (scan.state !== "scanning") return scanWord(scan.state);
  const { views } = scan.progress;
  const missing = views.filter((view) => view.state === "missing").length;
  const number = Math.max(views.length - missing, 1);
  const total = scan.views === "auto" ? undefined : cell.value?.viewpoints?.reachable;
  const moving = views.find((view) => view.state === "moving");
  let text =
    total === undefined ? t("scan.progress.view", { number }) : t("scan.progress.view_of", { number, total });
  if (moving !== undefined) text = t("scan.progress.at_viewpoint", { text, index: moving.index });
  return missing > 0 ? t("scan.progress.missing", { text, count: missing }) : text;
}
