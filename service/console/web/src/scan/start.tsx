import { api, slowly, told } from "../net/api";
import { calibrates, cell } from "../state/cell";
import { askNow } from "../state/follow";
import { room } from "../state/room";
import { show } from "../state/scans";
import { Act, Failed, type Action } from "../ui/action";
import { MethodField } from "../ui/method_field";
import { NumberField } from "../ui/number_field";
import { readNumber } from "../words/number";
import { CALIBRATES, METHODS } from "../words/states";
import { mm } from "../words/units";
import { Hold } from "./hold";
import { radiusOf, RadiusField, readRadius } from "./radius";
import { Reach } from "./reach";
import { Recordings } from "./recordings";
import { wanted, type Mode } from "./wanted";

/** What a scan is started with, and the button that does. */
export function Start({ action }: { action: Action }) {
  const mode = wanted.mode.value;
  const recording = wanted.recording.value;
  const method = wanted.method.value;
  const radius = readRadius(wanted.radius.value);
  const views = readNumber(wanted.views.value, { min: 2, max: 32, whole: true });
  const obstacle = inTheWay(mode, recording);
  const faulty = radius.fault !== null || (mode === "live" && views.fault !== null);

  async function start(): Promise<void> {
    const both = { string_radius_m: radiusOf(radius), method };
    const body = mode === "live" ? { ...both, mode, views: views.value } : { ...both, mode, recording: recording ?? "" };
    show(await told(api.POST("/api/scans", { body, ...slowly })));
    askNow();
  }

  return (
    <section class="panel start" aria-label="Start a scan">
      <fieldset>
        <legend>What to look at</legend>
        <Choice mode="live">The table, by the arm and its camera</Choice>
        <Choice mode="replay">A recording of an earlier scan; nothing moves</Choice>
      </fieldset>
      {mode === "replay" && <Recordings chosen={recording} choose={(id) => (wanted.recording.value = id)} />}
      <div class="row wide">
        <RadiusField reading={radius} write={(text) => (wanted.radius.value = text)} empty={emptyRadius(mode)} />
        <MethodField method={method} choose={(chosen) => (wanted.method.value = chosen)} />
        {mode === "live" && (
          <NumberField
            label="Viewpoints"
            hint="viewpoint"
            reading={views}
            write={(text) => (wanted.views.value = text)}
            empty={room.value ? `${room.value.scan.views}, as set` : "as set"}
          />
        )}
      </div>
      <p class="small">
        Method {METHODS[method].name}: {METHODS[method].hint}
      </p>
      <Act
        action={action}
        kind="main"
        big
        work={start}
        doing={mode === "live" ? "Preparing arm and camera ..." : "Beginning ..."}
        disabled={faulty || obstacle !== null}
      >
        {mode === "live" ? "Scan: the arm will move" : "Recognise the recording: nothing moves"}
      </Act>
      {!action.busy && obstacle !== null && <p class="note warn">{obstacle}</p>}
      <Failed failure={action.failure} />
      {mode === "live" && views.fault === null && <Reach views={views.value} />}
      {mode === "live" && <Hold />}
    </section>
  );
}

/** Why no scan can be begun now, in words; null: one can. */
function inTheWay(mode: Mode, recording: string | null): string | null {
  if (mode === "replay" && recording === null) return "Choose a recording first.";
  if (mode === "live" && cell.value?.state === "fault") return "The fault above comes first.";
  return calibrates.value ? CALIBRATES : null;
}

function emptyRadius(mode: Mode): string {
  const set = room.value?.scan.string_radius_m;
  if (mode === "replay") return "as recorded";
  return set ? `${mm(set)}, as set` : "measure it";
}

function Choice({ mode, children }: { mode: Mode; children: string }) {
  return (
    <label class="tick">
      <input type="radio" name="mode" checked={mode === wanted.mode.value} onChange={() => (wanted.mode.value = mode)} />
      {children}
    </label>
  );
}
