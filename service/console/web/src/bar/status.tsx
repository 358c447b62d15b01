import { computed } from "@preact/signals";
import type { ComponentChildren } from "preact";
import { calibration, cell } from "../state/cell";
import { lastHeard, lost, silent_s } from "../state/freshness";
import { live } from "../state/follow";
import { running } from "../state/scans";
import { caller, operates } from "../state/session";
import type { Cell } from "../net/api";
import { addressOf } from "../route";
import { WhatToDo } from "../ui/manual";
import { sentence } from "../words/sentence";
import { CELL, SCAN, SHAPES, VERDICTS, words, type Look } from "../words/states";
import { clock, span } from "../words/units";

/** A state: word, shape and colour. */
export function Badge({ look, children }: { look: Look; children: string }) {
  return (
    <strong class={`badge ${look}`}>
      <span aria-hidden="true">{SHAPES[look]}</span> {children}
    </strong>
  );
}

/** What is always in sight of the cell. */
export function Status() {
  return (
    <>
      <State />
      <dl class="facts">
        <Robot />
        <Camera />
        <CalibrationFact />
      </dl>
      <p class="small news">{newsWords()}</p>
    </>
  );
}

function State() {
  if (lost.value) return <LostState />;
  if (caller.value === null) {
    return (
      <div class="state" role="status">
        <Badge look="none">Nobody is signed in</Badge>
        <p>Sign in below to see the cell, and to be able to stop the arm from here.</p>
      </div>
    );
  }
  const now = cell.value;
  if (now === null) return <p class="state">Asking the cell ...</p>;
  const { word, look } = CELL[now.state];
  const scan = running.value;
  const doing = scan === null ? word : `${word}: ${SCAN[scan.state].word.toLowerCase()}`;
  return (
    <div class="state" role="status">
      <Badge look={look}>{now.state === "busy" ? doing : word}</Badge>
      <p>
        {reasonWords(now)} {now.state === "not_ready" && <WhatToDo problem={now.problem} />}
      </p>
    </div>
  );
}

/** Why the cell is as it is; what to do about it is told to those who may do it. */
function reasonWords({ reason }: Cell): string {
  if (reason === null) return operates.value ? "Press Scan when the table is as it should be." : "It waits for a scan.";
  return sentence(operates.value ? reason : reason.replace(/: connect, or start a live scan$/, ""));
}

function LostState() {
  const heard = lastHeard();
  return (
    <div class="state" role="alert">
      <Badge look="none">Not known: no connection</Badge>
      <p>
        {heard === null ? "The service has not answered yet." : `Last heard at ${clock(heard)}. What the page shows is as it was then.`}{" "}
        Stop is sent again and again once it is pressed, but nobody knows whether it gets through: if in doubt, use the
        emergency stop.
      </p>
    </div>
  );
}

function Fact({ name, look, children }: { name: string; look: Look; children: ComponentChildren }) {
  return (
    <div class={look}>
      <dt>{name}</dt>
      <dd>
        <span aria-hidden="true">{SHAPES[look]}</span> {children}
      </dd>
    </div>
  );
}

/** What was told last can be taken for what is. */
const fresh = computed(() => !lost.value && Boolean(caller.value));

/** Says so where a device is simulated: an operator must not take it for a real one. */
function kindWords(device: { kind: string }): string {
  return device.kind === "simulated" ? " (simulated)" : "";
}

function Robot() {
  const robot = cell.value?.robot;
  if (!robot || !fresh.value) return <Fact name="Robot" look="none">not known</Fact>;
  const { robot_mode, safety_mode } = robot;
  if (robot_mode === null || safety_mode === null) {
    const unheard = cell.value?.state === "fault" && robot.age_s !== null;
    const words = unheard ? `not heard for ${span(robot.age_s ?? 0)}: see its pendant` : `${robot.model}, not connected${kindWords(robot)}`;
    return <Fact name="Robot" look={unheard ? "warn" : "none"}>{words}</Fact>;
  }
  const safe = safety_mode === "normal" || safety_mode === "reduced";
  const look = !safe ? "bad" : robot_mode === "running" ? "good" : "warn";
  const moves = robot.moving === true ? ", moving" : "";
  return <Fact name="Robot" look={look}>{`${words(robot_mode)}${moves}; safety: ${words(safety_mode)}${kindWords(robot)}`}</Fact>;
}

function Camera() {
  const camera = cell.value?.camera;
  if (!camera || !fresh.value) return <Fact name="Camera" look="none">not known</Fact>;
  if (camera.width === null || cell.value?.state === "not_ready") return <Fact name="Camera" look="none">{`not connected${kindWords(camera)}`}</Fact>;
  const [warning] = camera.warnings;
  return <Fact name="Camera" look={warning ? "warn" : "good"}>{warning ?? `${camera.width} x ${camera.height}${kindWords(camera)}`}</Fact>;
}

function CalibrationFact() {
  const known = calibration.value !== null && fresh.value;
  return (
    <Fact name="Calibration" look={known ? calibrationLook() : "none"}>
      <a href={addressOf("calibration")}>{known ? calibrationWords() : "not known"}</a>
    </Fact>
  );
}

function calibrationLook(): Look {
  const used = calibration.value?.calibration;
  if (!used) return "bad";
  if (used.verdict === null) return "none";
  if (used.drift.drifted || used.verdict === "refuse" || calibration.value?.warnings.length) return "warn";
  return "good";
}

function calibrationWords(): string {
  const used = calibration.value?.calibration;
  if (!used) return "none that can be used";
  const verdict = used.verdict === null ? "not judged" : VERDICTS[used.verdict];
  const age = used.age_s === null ? "age not known" : `${span(used.age_s)} old`;
  return `${verdict}, ${age}${used.drift.drifted ? ", drifted" : ""}`;
}

function newsWords(): string {
  if (lost.value) return `Nothing heard for ${span(silent_s.value)}`;
  return live.value ? "Live" : "Asked for every few seconds";
}
