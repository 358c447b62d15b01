import { Badge } from "../bar/status";
import type { Scan } from "../net/api";
import { addressOf, go } from "../route";
import { recogniseAgain } from "../state/recognise_again";
import { calibrating, cell } from "../state/cell";
import { followed, latest, running } from "../state/scans";
import { canOperate } from "../state/session";
import { when } from "../texts/format";
import { foundText, hasModel, isElsewhere, kindOf, outcome, recordedViews, tooFew } from "../texts/states";
import { t } from "../texts/translate";
import { Act, Failed, useAction } from "../ui/action";
import { Doubts } from "../ui/doubts";
import { EndReason } from "../ui/end_reason";
import { SimulatedMark } from "../ui/simulated";
import { RadiusWarning } from "./radius_warning";
import { RecordingName } from "./recording_name";

/** The outcome of the last scan. */
export function LastScan({ scan }: { scan: Scan }) {
  const { word, tone } = outcome(scan);
  const { summary, problem } = scan;
  const { to_model, to_home } = scan.timing_s;
  const action = useAction();
  const again = latest.value?.source === scan.id ? latest.value : null;
  const shown = [scan, again].find((one) => one !== null && hasModel(one)) ?? null;
  const returns = running.value === null && scan.id === followed.value && cell.value?.state === "busy" && !calibrating.value;
  return (
    <section class="panel" aria-label={t("scan.last.region")}>
      <h2>
        <Badge tone={tone}>{word}</Badge>{" "}
        <SimulatedMark scan={scan} />{" "}
        {summary !== null && summary.chains > 0 && <span>{foundText(summary.chains, summary.crossings)}</span>}
      </h2>
      <p class="small">
        {t("scan.last.description", {
          kind: kindOf(scan),
          when: when(scan.created_at),
          method: t(`method.${scan.method}.name`),
        })}
        {isElsewhere(scan) && scan.recording !== null && <RecordingName id={scan.recording} />}
      </p>
      {to_model !== null && to_home !== null && (
        <p>{t("scan.last.time", { model: Math.round(to_model), home: Math.round(to_home) })}</p>
      )}
      {returns && <p>{t("scan.returning")}</p>}
      <EndReason state={scan.state} problem={problem} />
      <RadiusWarning scan={scan} />
      <Doubts summary={summary} />
      <p class="row">
        {shown !== null && (
          <a class="button main" href={addressOf("result", shown.id)}>
            {t("common.look_at_result")}
          </a>
        )}
        {shown === null && scan.links.reprocess !== null && !tooFew(scan) && canOperate.value && (
          <Act
            action={action}
            doing={t("common.starting")}
            disabled={running.value !== null || calibrating.value}
            work={async () => go("result", (await recogniseAgain(scan)).id)}
          >
            {t("scan.last.use_recorded")}
          </Act>
        )}
      </p>
      <Failed failure={action.failure} />
      {scan.mode === "live" && !hasModel(scan) && <p>{t("scan.last.recorded_views", { count: recordedViews(scan) })}</p>}
      {scan.mode === "live" && scan.state === "interrupted" && <p class="note warn">{t("scan.last.interrupted")}</p>}
    </section>
  );
}
