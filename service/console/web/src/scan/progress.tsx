import { api, slowly, told, type Scan } from "../net/api";
import { cell } from "../state/cell";
import { lost } from "../state/freshness";
import { show } from "../state/scans";
import { Act, Failed, useAction } from "../ui/action";
import { SCAN } from "../words/states";
import { percent } from "../words/units";
import { Badge } from "../bar/status";
import { Views } from "./views";

/** A scan under way. */
export function Progress({ scan }: { scan: Scan }) {
  const action = useAction();
  const { look } = SCAN[scan.state];
  return (
    <section class="panel" aria-label="Scan under way">
      <h2>
        <Badge look={lost.value ? "none" : look}>{lost.value ? `Not known; last: ${doing(scan)}` : doing(scan)}</Badge>
      </h2>
      <div class="done">
        <progress max={1} value={scan.progress.fraction} aria-label="Done of the whole" />
        <span>{percent(scan.progress.fraction)}</span>
      </div>
      {scan.asked_by !== null && <p class="small">Started by {scan.asked_by}</p>}
      <Act
        action={action}
        disabled={scan.links.cancel === null || scan.state === "stopping"}
        doing="Stopping ..."
        work={async () => show(await told(api.POST("/api/scans/{id}/cancel", { params: { path: { id: scan.id } }, ...slowly })))}
      >
        {scan.mode === "live" ? "Cancel this scan: the arm stops" : "Cancel"}
      </Act>
      <Failed failure={action.failure} />
      {scan.mode === "live" && <Views scan={scan} coming={comingOf(scan)} />}
    </section>
  );
}

/** The viewpoints that the arm has not come to yet, by the cell's plan. */
function comingOf(scan: Scan): number[] {
  const plan = cell.value?.viewpoints;
  if (!plan || !["preflight", "scanning"].includes(scan.state)) return [];
  const met = new Set([...scan.progress.views, ...plan.missing].map((view) => view.index));
  return Array.from({ length: plan.planned }, (_, index) => index).filter((index) => !met.has(index));
}

/** What is being done, in words; a screen reader tells it when it changes, as it is part of the bar too. */
function doing(scan: Scan): string {
  if (scan.state !== "scanning") return SCAN[scan.state].word;
  const views = scan.progress.views;
  const missing = views.filter((view) => view.state === "missing").length;
  const at = views.filter((view) => view.state !== "missing").length;
  const most = cell.value?.viewpoints?.reachable;
  const of = most === undefined ? "" : ` of ${most}`;
  const now = views.find((view) => view.state === "moving");
  const where = now === undefined ? "" : `, from viewpoint ${now.index}`;
  return `Taking view ${Math.max(at, 1)}${of}${where}${missing > 0 ? `; ${missing} missing` : ""}`;
}
