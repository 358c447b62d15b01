import { reasonText } from "../bar/status";
import { api, longCall, resultOf, type Scan } from "../net/api";
import { calibrating, cell } from "../state/cell";
import { geometry } from "../state/geometry";
import { requesting, show } from "../state/scans";
import { refreshNow } from "../state/updates";
import { mm } from "../texts/format";
import { t } from "../texts/translate";
import { Act, Failed, type Action } from "../ui/action";
import { MethodField } from "../ui/method_field";
import { NumberField } from "../ui/number_field";
import { parseNumber } from "../ui/parse_number";
import { Connection } from "./connection";
import { form, type Mode } from "./form_state";
import { parseRadius, RadiusField, radiusMetres } from "./radius_field";
import { Reachability } from "./reachability";
import { Recordings } from "./recordings";

/** Undefined: as configured, as long as the configuration is not known here. */
type Views = Scan["views"] | undefined;

/** Number of viewpoints of a scan that is not quick if the configuration gives none. */
const DEFAULT_VIEWPOINTS = 8;

/** The form that starts a scan. While the page is settling, it cannot be sent. */
export function Start({ action, settling }: { action: Action; settling: boolean }) {
  const mode = form.mode.value;
  const recording = form.recording.value;
  const method = form.method.value;
  const radius = parseRadius(form.radius.value);
  const configured = geometry.value?.scan.views;
  const usual = configured === "auto" ? DEFAULT_VIEWPOINTS : configured;
  const quick = form.quick.value ?? configured === "auto";
  const number = parseNumber(quick ? "" : form.views.value, { min: 1, max: 32, whole: true });
  const views: Views = quick ? "auto" : (number.value ?? usual);
  const obstacle = obstacleText(mode, recording);
  const invalid = radius.fault !== null || (mode === "live" && number.fault !== null);

  async function start(): Promise<void> {
    const both = { string_radius_m: radiusMetres(radius), method, all_grasps: false, validate_only: false };
    const body = mode === "live" ? { ...both, mode, views } : { ...both, mode, recording: recording ?? "" };
    requesting.value = true;
    try {
      const started = await resultOf(api.POST("/api/scans", { body, ...longCall }));
      if ("links" in started) show(started);
    } finally {
      requesting.value = false;
    }
    refreshNow();
  }

  return (
    <section class="panel start" aria-label={t("scan.start.region")}>
      <fieldset class="choices">
        <legend class="unseen">{t("scan.start.source")}</legend>
        <Choice mode="live" />
        <Choice mode="replay" />
      </fieldset>
      {mode === "replay" && <Recordings chosen={recording} choose={(id) => (form.recording.value = id)} />}
      <Act
        action={action}
        kind="main"
        big
        work={start}
        doing={t("common.starting")}
        disabled={invalid || obstacle !== null || settling}
      >
        {mode === "live" ? t("scan.start.button_live") : t("scan.start.button_replay")}
      </Act>
      {cell.value?.state === "not_ready" && <p class="small narrow-only">{reasonText(cell.value)}</p>}
      {!action.busy && obstacle !== null && <p class="note warn">{obstacle}</p>}
      <Failed failure={action.failure} />
      {mode === "live" && number.fault === null && views && <Reachability key={views} views={views} />}
      <div class="row wide">
        <RadiusField number={radius} write={(text) => (form.radius.value = text)} empty={radiusPlaceholder(mode)} />
        <MethodField method={method} choose={(chosen) => (form.method.value = chosen)} />
        {mode === "live" && !quick && (
          <NumberField
            label={t("scan.start.viewpoints")}
            hint="viewpoint"
            number={number}
            write={(text) => (form.views.value = text)}
            empty={viewsPlaceholder(configured)}
          />
        )}
      </div>
      {mode === "live" && (
        <label class="tick">
          <input
            type="checkbox"
            checked={quick}
            onChange={(event) => (form.quick.value = event.currentTarget.checked)}
          />
          {t("scan.start.quick")}
        </label>
      )}
      <p class="small">
        {t("method.described", { name: t(`method.${method}.name`), hint: t(`method.${method}.hint`) })}
      </p>
      {mode === "live" && <Connection />}
    </section>
  );
}

/** Return why no scan can be started now; null: one can. */
function obstacleText(mode: Mode, recording: string | null): string | null {
  if (mode === "replay" && recording === null) return t("scan.start.choose_recording");
  if (mode === "live" && cell.value?.state === "fault") return t("scan.start.fault_first");
  return calibrating.value ? t("scan.start.calibrating") : null;
}

function radiusPlaceholder(mode: Mode): string {
  const configured_m = geometry.value?.scan.string_radius_m;
  if (mode === "replay") return t("scan.start.as_recorded");
  return configured_m ? t("scan.start.configured", { value: mm(configured_m) }) : t("scan.start.measure");
}

function viewsPlaceholder(configured: Views): string {
  if (configured === "auto") return String(DEFAULT_VIEWPOINTS);
  return configured ? t("scan.start.configured", { value: configured }) : t("scan.start.configured_unknown");
}

function Choice({ mode }: { mode: Mode }) {
  return (
    <label class="tick">
      <input type="radio" name="mode" checked={mode === form.mode.value} onChange={() => (form.mode.value = mode)} />
      {t(`scan.start.${mode}`)}
    </label>
  );
}
