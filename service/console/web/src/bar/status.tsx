import { computed } from "@preact/signals";
import type { ComponentChildren } from "preact";
import { useState } from "preact/hooks";
import type { Cell } from "../net/api";
import { addressOf } from "../route";
import { calibration, cell, problemSlug } from "../state/cell";
import { lastAnswer, lost, silence_s } from "../state/freshness";
import { requesting, running, scanTime } from "../state/scans";
import { caller, canOperate } from "../state/session";
import { live } from "../state/live";
import { clock, span } from "../texts/format";
import { problemTitle, slugOf } from "../texts/problem";
import { sentence } from "../texts/sentence";
import { CELL_TONES, scanWord, SHAPES, type Tone, verdictWord } from "../texts/states";
import { findText, t } from "../texts/translate";
import { WhatToDo } from "../ui/manual";
import { Original } from "../ui/original";
import { SimulatedCell } from "../ui/simulated";

/** A state: word, shape and colour. */
export function Badge({ tone, children }: { tone: Tone; children: ComponentChildren }) {
  return (
    <strong class={`badge ${tone}`}>
      <span aria-hidden="true">{SHAPES[tone]}</span> {children}
    </strong>
  );
}

/** The ID of the facts. `useId` would give one that also exists below the bar, which is drawn separately. */
const FACTS_ID = "bar-facts";

/** The part of the bar that shows the cell. */
export function Status() {
  const [open, setOpen] = useState(false); // on a phone; elsewhere the facts are always visible
  return (
    <>
      <div class="cell-line">
        <State />
        {cell.value !== null && <SimulatedCell cell={cell.value} />}
        <p class="small news">{newsText()}</p>
        {caller.value && (
          <button
            type="button"
            class="more"
            aria-expanded={open}
            aria-controls={FACTS_ID}
            aria-label={t("state.more")}
            onClick={() => setOpen(!open)}
          >
            {open ? "▴" : "▾"}
          </button>
        )}
      </div>
      <dl class={open ? "facts open" : "facts"} id={FACTS_ID}>
        <Robot />
        <Camera />
        <CalibrationFact />
      </dl>
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
  const activity = activityText();
  if (now.state === "busy" || (activity !== null && now.state !== "fault")) {
    return (
      <div class="state calm" role="status">
        <Badge tone="work">
          {t("state.cell.busy")}
          {activity !== null && <span class="activity">{t("state.busy_with", { activity })}</span>}
        </Badge>
        <p>{timeText() ?? (now.state === "busy" ? reasonText(now) : "")}</p>
      </div>
    );
  }
  // The page says the rest: the Scan screen, or the panel about the stop or fault.
  const stopped = problemSlug.value === "stopped";
  const calm = now.state !== "not_ready" || stopped || problemSlug.value === "not-connected";
  return (
    <div class={calm ? "state calm" : "state"} role="status">
      <Badge tone={CELL_TONES[now.state]}>{state}</Badge>
      <p>
        {reasonText(now, canOperate.value && !stopped)}{" "}
        {!calm && <Original shown={reasonText(now)} text={sentence(now.reason ?? "")} />}{" "}
        {now.state === "not_ready" && !stopped && <WhatToDo problem={now.problem} />}
      </p>
    </div>
  );
}

/** Return a reason of the service without its advice, which the page gives in its own words. */
export function withoutAdvice(reason: string): string {
  return reason.replace(/: connect, or start a live scan$/, "").replace(/^look at the cell and acknowledge first: /, "");
}

/** Return what the scan does that runs, or was asked for; null: there is none. */
function activityText(): string | null {
  const scan = running.value;
  if (scan !== null) return inSentence(scanWord(scan.state));
  return requesting.value ? inSentence(t("common.starting")) : null;
}

/** Return how long the running scan will take to its model; null: not known. */
function timeText(): string | null {
  const { remaining } = scanTime.value;
  return remaining ? t("state.time_to_model", { seconds: Math.ceil(remaining) }) : null;
}

/** Return a text that continues a sentence. */
function inSentence(text: string): string {
  return text.charAt(0).toLowerCase() + text.slice(1);
}

/** Return why the cell is in its state. The advice what to do is for callers who may do it. */
export function reasonText({ reason, problem }: Cell, withAdvice = canOperate.value): string {
  if (reason === null) return withAdvice ? t("state.ready.operator") : t("state.ready.viewer");
  const shown = withAdvice ? reason : withoutAdvice(reason);
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

function Robot() {
  const robot = cell.value?.robot;
  const name = t("state.robot.label");
  if (!robot || !fresh.value) return <Fact name={name} tone="none">{t("common.unknown")}</Fact>;
  const { robot_mode, safety_mode } = robot;
  if (robot_mode === null || safety_mode === null) {
    if (cell.value?.state === "fault" && robot.age_s !== null) {
      // After other faults the robot answers, but it is not read any more.
      const key = problemSlug.value === "robot-lost" ? "state.robot.no_answer" : "state.robot.last_read";
      return <Fact name={name} tone="warn">{t(key, { time: span(robot.age_s) })}</Fact>;
    }
    return <Fact name={name} tone="none">{t("state.robot.not_connected", { model: robot.model })}</Fact>;
  }
  const safe = safety_mode === "normal" || safety_mode === "reduced";
  const tone = !safe ? "bad" : robot_mode === "running" ? "good" : "warn";
  const word = modeWord("mode", robot_mode);
  const mode = robot.moving === true ? t("state.robot.moving", { mode: word }) : word;
  const text = t("state.robot.modes", { mode, safety: modeWord("safety", safety_mode) });
  return <Fact name={name} tone={tone}>{text}</Fact>;
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
  const kept = problemSlug.value === "stopped"; // a stop does not disconnect it
  if (width === null || height === null || (cell.value?.state === "not_ready" && !kept)) {
    return <Fact name={name} tone="none">{t("state.camera.not_connected")}</Fact>;
  }
  const [warning] = camera.warnings;
  const size = t("state.camera.size", { width, height });
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
