import { Badge } from "../bar/status";
import { api, longCall, resultOf, type Scan } from "../net/api";
import { cell } from "../state/cell";
import { lost } from "../state/freshness";
import { scanTime, show } from "../state/scans";
import { percent } from "../texts/format";
import { recordedViews, SCAN_TONES, scanWord } from "../texts/states";
import { t } from "../texts/translate";
import { Act, Failed, useAction } from "../ui/action";
import { SimulatedMark } from "../ui/simulated";

/** A scan that runs. */
export function Progress({ scan }: { scan: Scan }) {
  const action = useAction();
  const activity = activityText(scan);
  const moving = movingText(scan);
  const { fraction } = scan.progress;
  const { elapsed, remaining } = scanTime.value;
  return (
    <section class="panel" aria-label={t("scan.progress.region")}>
      <h2>
        <Badge tone={lost.value ? "none" : SCAN_TONES[scan.state]}>
          {lost.value ? t("scan.progress.unknown", { activity }) : activity}
        </Badge>{" "}
        <SimulatedMark scan={scan} />
      </h2>
      <div class="done">
        <progress max={1} value={fraction} aria-label={t("common.progress")} />
        <span>{percent(fraction)}</span>
      </div>
      {elapsed !== null && remaining !== null && !lost.value && (
        <p class="small">
          {remaining > 0
            ? t("scan.progress.time", { elapsed: Math.round(elapsed), remaining: Math.ceil(remaining) })
            : t("scan.progress.elapsed", { elapsed: Math.round(elapsed) })}
        </p>
      )}
      {moving !== null && !lost.value && <p>{moving}</p>}
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
    </section>
  );
}

/** Return what the scan does now. The bar announces a change to screen readers. */
function activityText(scan: Scan): string {
  if (scan.state !== "scanning") return scanWord(scan.state);
  const { views } = scan.progress;
  const missing = views.filter((view) => view.state === "missing").length;
  const recorded = recordedViews(scan);
  const total = scan.views === "auto" ? undefined : cell.value?.viewpoints?.reachable;
  const text =
    total === undefined ? t("scan.progress.views", { count: recorded }) : t("scan.progress.views_of", { recorded, total });
  return missing > 0 ? t("scan.progress.missing", { text, count: missing }) : text;
}

/** Return where the arm goes; null: it is not known that it moves. */
function movingText({ mode, progress, state }: Scan): string | null {
  const moving = progress.views.find((view) => view.state === "moving");
  if (moving !== undefined) return t("scan.progress.moving", { index: moving.index });
  return mode === "live" && state === "processing" && cell.value?.state === "busy" ? t("scan.returning") : null;
}
