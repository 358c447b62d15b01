import { useState } from "preact/hooks";
import { api, slowly, told, type Method, type Scan } from "../net/api";
import { cell } from "../state/cell";
import { askNow } from "../state/follow";
import { room } from "../state/room";
import { show } from "../state/scans";
import { Act, Failed, useAction } from "../ui/action";
import { Field } from "../ui/field";
import { METHODS } from "../words/states";
import { mm } from "../words/units";
import { Hold } from "./hold";
import { Reach } from "./reach";
import { Recordings } from "./recordings";

type Mode = Scan["mode"];

/** What a scan is started with, and the button that does. */
export function Start() {
  const [mode, setMode] = useState<Mode>("live");
  const [recording, setRecording] = useState<string | null>(null);
  const [radius_mm, setRadius] = useState("");
  const [method, setMethod] = useState<Method>("graph");
  const [views, setViews] = useState("");
  const action = useAction();
  const fault = cell.value?.state === "fault";

  async function start(): Promise<void> {
    const string_radius_m = radius_mm === "" ? null : Number(radius_mm) / 1000;
    const wanted = { string_radius_m, method };
    const body =
      mode === "live"
        ? { ...wanted, mode, views: views === "" ? null : Number(views) }
        : { ...wanted, mode, recording: recording ?? "" };
    show(await told(api.POST("/api/scans", { body, ...slowly })));
    askNow();
  }

  return (
    <section class="panel start" aria-label="Start a scan">
      <fieldset>
        <legend>What to look at</legend>
        <Choice mode="live" chosen={mode} choose={setMode}>
          The table, by the arm and its camera
        </Choice>
        <Choice mode="replay" chosen={mode} choose={setMode}>
          A recording of an earlier scan; nothing moves
        </Choice>
      </fieldset>
      {mode === "replay" && <Recordings chosen={recording} choose={setRecording} />}
      <div class="row wide">
        <Field label="String radius, in mm" hint="string radius">
          {(id) => (
            <input
              id={id}
              type="number"
              inputMode="decimal"
              step="any"
              min="0"
              value={radius_mm}
              placeholder={emptyRadius(mode)}
              onInput={(event) => setRadius(event.currentTarget.value)}
            />
          )}
        </Field>
        <Field label="Method" hint="method">
          {(id) => (
            <select id={id} value={method} onChange={(event) => setMethod(event.currentTarget.value as Method)}>
              {Object.entries(METHODS).map(([value, { name }]) => (
                <option key={value} value={value}>
                  {name}
                </option>
              ))}
            </select>
          )}
        </Field>
        {mode === "live" && (
          <Field label="Viewpoints" hint="viewpoint">
            {(id) => (
              <input
                id={id}
                type="number"
                inputMode="numeric"
                min="2"
                max="32"
                value={views}
                placeholder={room.value ? `${room.value.scan.views}, as set` : "as set"}
                onInput={(event) => setViews(event.currentTarget.value)}
              />
            )}
          </Field>
        )}
      </div>
      <p class="small">{METHODS[method].hint}</p>
      <Act
        action={action}
        kind="main"
        big
        work={start}
        doing={mode === "live" ? "Preparing arm and camera ..." : "Beginning ..."}
        disabled={mode === "live" ? fault : recording === null}
      >
        {mode === "live" ? "Scan: the arm will move" : "Recognise the recording: nothing moves"}
      </Act>
      {mode === "live" && fault && <p class="note bad">The fault above comes first.</p>}
      <Failed failure={action.failure} />
      {mode === "live" && <Reach views={views === "" ? null : Number(views)} />}
      {mode === "live" && <Hold />}
    </section>
  );
}

function emptyRadius(mode: Mode): string {
  const set = room.value?.scan.string_radius_m;
  if (mode === "replay") return "as recorded";
  return set ? `${mm(set)}, as set` : "measure it";
}

interface ChoiceProps {
  mode: Mode;
  chosen: Mode;
  choose: (mode: Mode) => void;
  children: string;
}

function Choice({ mode, chosen, choose, children }: ChoiceProps) {
  return (
    <label class="tick">
      <input type="radio" name="mode" checked={mode === chosen} onChange={() => choose(mode)} />
      {children}
    </label>
  );
}
