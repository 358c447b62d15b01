import { computed } from "@preact/signals";
import type { ComponentChildren } from "preact";
import type { Cell } from "../net/api";
import { addressOf } from "../route";
import { calibration, cell } from "../state/cell";
import { lastAnswer, lost, silence_s } from "../state/freshness";
import { running } from "../state/scans";
import { caller, canOperate } from "../state/session";
import { live } from "../state/updates";
import { clock, span } from "../texts/format";
import { problemTitle, slugOf } from "../texts/problem";
import { sentence } from "../texts/sentence";
import { CELL_TONES, scanWord, SHAPES, type Tone, verdictWord } from "../texts/states";
import { findText, t } from "../texts/translate";
import { WhatToDo } from "../ui/manual";

/** A state: word, shape and colour. */
export function Badge({ tone, children }: { tone: Tone; children: string }) {
  return (
    <strong class={`badge ${tone}`}>
      <span aria-hidden="true">{SHAPES[tone]}</span> {children}
    </strong>
  );
}

/** The part of the bar that shows the cell. */
export function Status() {
  return (
    <>
      <State />
      <dl class="facts">
        <Robot />
        <Camera />
        <CalibrationFact />
      </dl>
      <p class="small news">{newsText()}</p>
    </>
  );
}

function State() {
  if (lost.value) return <LostState />;
  if (caller.value === null) {
    return (
      <div class="state" role="status">
        <Badge tone="none">{t("state.signed_out.title")}</Badge>
        <p>{t("state.signed_out.detail")}</p>
      </div>
    );
  }
  const now = cell.value;
  if (now === null) return <p class="state">{t("state.waiting")}</p>;
  const state = t(`state.cell.${now.state}`);
  const scan = running.value;
  const busyWith =
    scan === null ? state : t("state.busy_with", { state, activity: scanWord(scan.state).toLowerCase() });
  return (
    <div class="state" role="status">
      <Badge tone={CELL_TONES[now.state]}>{now.state === "busy" ? busyWith : state}</Badge>
      <p>
        {reasonText(now)} {now.state === "not_ready" && <WhatToDo problem={now.problem} />}
      </p>
    </div>
  );
}

/** Return why the cell is in its state. The hint what to do is only for callers who may do it. */
function reasonText({ reason, problem }: Cell): string {
  if (reason === null) return canOperate.value ? t("state.ready.operator") : t("state.ready.viewer");
  const shown = canOperate.value ? reason : reason.replace(/: connect, or start a live scan$/, "");
  return sentence(problemTitle(problem && slugOf(problem), shown));
}

function LostState() {
  const answered = lastAnswer();
  return (
    <div class="state" role="alert">
      <Badge tone="none">{t("state.lost.title")}</Badge>
      <p>
        {answered === null ? t("state.lost.never") : t("state.lost.since", { time: clock(answered) })}{" "}
        {t("state.lost.stop")}
      </p>
    </div>
  );
}

function Fact({ name, tone, children }: { name: string; tone: Tone; children: ComponentChildren }) {
  return (
    <div class={tone}>
      <dt>{name}</dt>
      <dd>
        <span aria-hidden="true">{SHAPES[tone]}</span> {children}
      </dd>
    </div>
  );
}

/** Whether the last known state is still valid. */
const fresh = computed(() => !lost.value && Boolean(caller.value));

/** Mark a simulated device: an operator must not mistake it for a real one. */
function withKind(text: string, device: { kind: string }): string {
  return device.kind === "simulated" ? t("state.robot.simulated", { text }) : text;
}

function Robot() {
  const robot = cell.value?.robot;
  const name = t("state.robot.label");
  if (!robot || !fresh.value) return <Fact name={name} tone="none">{t("common.unknown")}</Fact>;
  const { robot_mode, safety_mode } = robot;
  if (robot_mode === null || safety_mode === null) {
    if (cell.value?.state === "fault" && robot.age_s !== null) {
      return <Fact name={name} tone="warn">{t("state.robot.no_answer", { time: span(robot.age_s) })}</Fact>;
    }
    return <Fact name={name} tone="none">{withKind(t("state.robot.not_connected", { model: robot.model }), robot)}</Fact>;
  }
  const safe = safety_mode === "normal" || safety_mode === "reduced";
  const tone = !safe ? "bad" : robot_mode === "running" ? "good" : "warn";
  const word = modeWord("mode", robot_mode);
  const mode = robot.moving === true ? t("state.robot.moving", { mode: word }) : word;
  const text = t("state.robot.modes", { mode, safety: modeWord("safety", safety_mode) });
  return <Fact name={name} tone={tone}>{withKind(text, robot)}</Fact>;
}

/** Return the text for a mode of the robot; a mode without one is shown by its name. */
function modeWord(kind: "mode" | "safety", name: string): string {
  return findText(`state.robot.${kind}.${name}`) ?? name.replaceAll("_", " ");
}

function Camera() {
  const camera = cell.value?.camera;
  const name = t("state.camera.label");
  if (!camera || !fresh.value) return <Fact name={name} tone="none">{t("common.unknown")}</Fact>;
  const { width, height } = camera;
  if (width === null || height === null || cell.value?.state === "not_ready") {
    return <Fact name={name} tone="none">{withKind(t("state.camera.not_connected"), camera)}</Fact>;
  }
  const [warning] = camera.warnings;
  const size = withKind(t("state.camera.size", { width, height }), camera);
  return <Fact name={name} tone={warning ? "warn" : "good"}>{warning ?? size}</Fact>;
}

function CalibrationFact() {
  const known = calibration.value !== null && fresh.value;
  return (
    <Fact name={t("state.calibration.label")} tone={known ? calibrationTone() : "none"}>
      <a href={addressOf("calibration")}>{known ? calibrationText() : t("common.unknown")}</a>
    </Fact>
  );
}

function calibrationTone(): Tone {
  const used = calibration.value?.calibration;
  if (!used) return "bad";
  if (used.verdict === null) return "none";
  if (used.drift.drifted || used.verdict === "refuse" || calibration.value?.warnings.length) return "warn";
  return "good";
}

function calibrationText(): string {
  const used = calibration.value?.calibration;
  if (!used) return t("state.calibration.none");
  const verdict = verdictWord(used.verdict);
  const text =
    used.age_s === null
      ? t("state.calibration.age_unknown", { verdict })
      : t("state.calibration.age", { verdict, age: span(used.age_s) });
  return used.drift.drifted ? t("state.calibration.drifted", { text }) : text;
}

function newsText(): string {
  if (lost.value) return t("state.news.lost", { time: span(silence_s.value) });
  return live.value ? t("state.news.live") : t("state.news.polling");
}
