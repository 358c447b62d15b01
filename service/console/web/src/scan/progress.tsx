import { api, slowly, told, type Scan } from "../net/api";
import { cell } from "../state/cell";
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
  const coming = Math.max(0, (cell.value?.viewpoints?.reachable ?? 0) - scan.progress.views.length);
  return (
    <section class="panel" aria-label="Scan under way">
      <h2>
        <Badge look={look}>{doing(scan)}</Badge>
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
      {scan.mode === "live" && <Views scan={scan} coming={coming} />}
    </section>
  );
}

/** What is being done, in words; a screen reader tells it when it changes, as it is part of the bar too. */
function doing(scan: Scan): string {
  if (scan.state !== "scanning") return SCAN[scan.state].word;
  const views = scan.progress.views;
  const missing = views.filter((view) => view.state === "missing").length;
  const at = views.filter((view) => view.state !== "missing").length;
  const most = cell.value?.viewpoints?.reachable;
  const of = most === undefined ? "" : ` of ${most}`;
  return `Taking view ${Math.max(at, 1)}${of}${missing > 0 ? `, ${missing} missing` : ""}`;
}
