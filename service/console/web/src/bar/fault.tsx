import { useEffect, useRef, useState } from "preact/hooks";
import { api, longCall, resultOf, type Cell } from "../net/api";
import { cell, problemSlug } from "../state/cell";
import { lost } from "../state/freshness";
import { running } from "../state/scans";
import { canMaintain } from "../state/session";
import { refreshNow } from "../state/updates";
import { clock } from "../texts/format";
import { isSafetyStop, problemTitle } from "../texts/problem";
import { sentence } from "../texts/sentence";
import { findText, t } from "../texts/translate";
import { Failed, useAction } from "../ui/action";
import { WhatToDo } from "../ui/manual";
import { withoutAdvice } from "./status";
import { Original } from "../ui/original";

/** Return what to check before a fault is acknowledged: the texts 1, 2, ... of its problem. */
function checksOf(slug: string): string[] {
  const checks: string[] = [];
  for (;;) {
    const check = findText(`fault.check.${slug}.${checks.length + 1}`);
    if (check === undefined) return checks;
    checks.push(check);
  }
}

/** After a fault, on every screen: what to do, and then that it is acknowledged. */
export function Fault() {
  const place = useRef<HTMLDivElement>(null);
  const height_px = useRef(0);
  const [seen, setSeen] = useState(false);
  const active = cell.value?.state === "fault";
  const scans = running.value !== null;
  const acknowledged = cell.value?.last_acknowledgement;
  const earlier = useRef<string | null>(null);
  if (active) earlier.current = acknowledged?.at ?? null; // of another fault
  useEffect(() => {
    if (active) setSeen(true);
    else if (scans) setSeen(false);
  }, [active, scans]);
  useEffect(() => {
    if (!active || place.current === null) return;
    const resized = new ResizeObserver(([entry]) => {
      // Its last change is that to the lower panel of an acknowledged fault.
      if (cell.value?.state === "fault") height_px.current = entry?.contentRect.height ?? 0;
    });
    resized.observe(place.current);
    return () => resized.disconnect();
  }, [active]);
  return (
    <div ref={place}>
      {active && <ActiveFault />}
      {!active && seen && !scans && (
        <PastFault
          acknowledged={acknowledged && acknowledged.at !== earlier.current ? acknowledged : null}
          height_px={height_px.current}
          close={() => setSeen(false)}
        />
      )}
    </div>
  );
}

interface PastFaultProps {
  /** Null: not known yet, or never, as after a restart of the service. */
  acknowledged: Cell["last_acknowledgement"];
  /** Height of the panel of the fault. The page does not move when somebody acknowledges elsewhere. */
  height_px: number;
  close: () => void;
}

/** In place of the fault, until it is closed: who acknowledged it, and when. */
function PastFault({ acknowledged, height_px, close }: PastFaultProps) {
  return (
    <div class="panel past-fault" style={{ minHeight: `${height_px}px` }}>
      <p role="status">{acknowledged === null ? t("fault.over") : acknowledgedText(acknowledged)}</p>
      <button type="button" onClick={close}>
        {t("common.close")}
      </button>
    </div>
  );
}

function acknowledgedText({ at, by }: NonNullable<Cell["last_acknowledgement"]>): string {
  const time = clock(new Date(at));
  return by === null ? t("fault.acknowledged_at", { time }) : t("fault.acknowledged_by", { time, name: by });
}

/** What happened, what to check and, for a maintainer, the acknowledgement. */
function ActiveFault() {
  const slug = problemSlug.value;
  const reason = withoutAdvice(cell.value?.reason ?? t("fault.title"));
  const title = sentence(problemTitle(slug, reason));
  const specific = checksOf(slug ?? "");
  const checks = specific.length > 0 ? specific : checksOf("motion-failed");
  return (
    <section class="panel fault" aria-label={t("fault.region")}>
      <h2>{title}</h2>
      {!isSafetyStop(slug) && <Original shown={title} text={sentence(reason)} />}
      <p>{t("fault.intro")}</p>
      <ol>
        {checks.map((check) => (
          <li key={check}>{check}</li>
        ))}
      </ol>
      <p>
        <WhatToDo problem={cell.value?.problem ?? null} />
      </p>
      {canMaintain.value ? <Acknowledge /> : <p class="note warn">{t("fault.ask_maintainer")}</p>}
    </section>
  );
}

function Acknowledge() {
  const [checked, setChecked] = useState(false);
  const action = useAction();
  const wait_s = useCountdown(action.failure?.slug === "too-early" ? (action.failure.retryAfter_s ?? 1) : 0);
  return (
    <>
      <label class="tick">
        <input type="checkbox" checked={checked} onChange={(event) => setChecked(event.currentTarget.checked)} />
        {t("fault.checked")}
      </label>
      <button
        type="button"
        class="main"
        disabled={!checked || action.busy || wait_s > 0 || lost.value}
        onClick={() =>
          void action.run(async () => {
            cell.value = await resultOf(api.POST("/api/cell/acknowledge", longCall));
            refreshNow();
          })
        }
      >
        {wait_s > 0 ? t("fault.wait", { count: wait_s }) : t("fault.acknowledge")}
      </button>
      <Failed failure={action.failure} />
    </>
  );
}

/** Count down the seconds from `from_s`, and start again whenever it changes. */
function useCountdown(from_s: number): number {
  const [left_s, setLeft] = useState(0);
  useEffect(() => {
    setLeft(from_s);
    const timer = setInterval(() => setLeft((before) => Math.max(0, before - 1)), 1000);
    return () => clearInterval(timer);
  }, [from_s]);
  return left_s;
}
