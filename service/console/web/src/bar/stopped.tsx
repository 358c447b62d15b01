import { cell, problemSlug } from "../state/cell";
import { lost } from "../state/freshness";
import { requesting, running } from "../state/scans";
import { canOperate } from "../state/session";
import { sentence } from "../texts/sentence";
import { clock } from "../texts/format";
import { t } from "../texts/translate";
import { reasonText, withoutAdvice } from "./status";
import { WhatToDo } from "../ui/manual";
import { Original } from "../ui/original";

/** After a stop, on every screen: what holds now, and what to do next. It is open on the screen that scans. */
export function Stopped({ open }: { open: boolean }) {
  if (problemSlug.value !== "stopped" || cell.value?.state !== "not_ready") return null;
  if (lost.value || requesting.value || running.value !== null) return null;
  const title = reasonText(cell.value, false);
  return (
    <section class="panel stopped" aria-label={t("stopped.region")}>
      <details key={String(open)} open={open}>
        <summary>{title}</summary>
        <Original shown={title} text={sentence(withoutAdvice(cell.value.reason ?? ""))} />
        <Who />
        <p>{t("stopped.holds")}</p>
        <ol>
          <li>{t("stopped.find_out")}</li>
          <li>{t("stopped.check")}</li>
          <li>{canOperate.value ? t("stopped.scan") : t("stopped.ask_operator")}</li>
        </ol>
        <p>
          <WhatToDo problem={cell.value.problem} />
        </p>
      </details>
    </section>
  );
}

/** Who stopped the arm, and when. */
function Who() {
  const stop = cell.value?.last_stop;
  if (!stop) return null;
  const time = clock(new Date(stop.at));
  return <p>{stop.by === null ? t("stopped.at", { time }) : t("stopped.by", { time, name: stop.by })}</p>;
}
