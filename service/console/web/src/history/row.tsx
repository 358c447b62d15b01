import { useEffect, useRef, useState } from "preact/hooks";
import { Badge } from "../bar/status";
import { api, resultOf, type Scan } from "../net/api";
import { addressOf } from "../route";
import { RecordingName } from "../scan/recording_name";
import { canOperate } from "../state/session";
import { mm, when } from "../texts/format";
import { foundText, hasModel, isElsewhere, kindOf, outcome, tooFew } from "../texts/states";
import { rich, t } from "../texts/translate";
import { Act, Failed, useAction } from "../ui/action";
import { Doubts } from "../ui/doubts";
import { EndReason } from "../ui/end_reason";
import { Picture } from "../ui/picture";
import { SimulatedMark } from "../ui/simulated";
import { ResultFiles } from "../ui/result_files";
import { Reprocess } from "./reprocess";

interface RowProps {
  scan: Scan;
  /** Called with the new state of the scan. */
  changed: (scan: Scan) => void;
}

/** A scan of the list; an open row has all its actions. */
export function Row({ scan, opened, changed }: RowProps & { opened: boolean }) {
  const [open, setOpen] = useState(opened);
  const row = useRef<HTMLLIElement>(null);
  useEffect(() => {
    if (opened) row.current?.scrollIntoView({ block: "center" });
  }, []);
  const { word, tone } = outcome(scan);
  const name = t("common.kind_and_time", { kind: kindOf(scan), when: when(scan.created_at) });
  return (
    <li ref={row}>
      <button type="button" class="headline" aria-expanded={open} onClick={() => setOpen(!open)}>
        {hasModel(scan) ? (
          <Picture src={scan.links.thumbnail ?? ""} alt="" class="thumbnail" />
        ) : (
          <span class="picture thumbnail">{t("history.row.no_result")}</span>
        )}
        <span class="what">
          <strong>{name}</strong>
          <span>{summaryText(scan)}</span>
          <span>
            <SimulatedMark scan={scan} />
          </span>
        </span>
        <Badge tone={tone}>{word}</Badge>
      </button>
      {open && <Details scan={scan} name={name} changed={changed} />}
    </li>
  );
}

function summaryText({ summary, method, string_radius_m, requested_by, kept }: Scan): string {
  let text = t(`method.${method}.name`);
  if (summary?.chains) text = t("history.row.found", { found: foundText(summary.chains, summary.crossings), text });
  if (string_radius_m !== null) text = t("history.row.radius", { text, radius: mm(string_radius_m) });
  if (requested_by !== null) text = t("history.row.by", { text, name: requested_by });
  return kept ? t("history.row.kept", { text }) : text;
}

function Details({ scan, name, changed }: RowProps & { name: string }) {
  const keep = useAction();
  const { links, problem, summary } = scan;
  const link = (content: preact.ComponentChildren) => <a href={addressOf("history", scan.source)}>{content}</a>;
  return (
    <div class="details" role="group" aria-label={name}>
      <EndReason state={scan.state} problem={problem} />
      <Doubts summary={summary} />
      <p class="small">
        {scan.string_radius_m === null &&
          (hasModel(scan) ? t("history.row.radius_measured") : t("history.row.radius_requested"))}
        {scan.source !== null && rich("history.row.source", { link })}
        {scan.id}
        {isElsewhere(scan) && scan.recording !== null && <RecordingName id={scan.recording} />}
      </p>
      <div class="row">
        {hasModel(scan) && (
          <a class="button main" href={addressOf("result", scan.id)}>
            {t("common.look_at_result")}
          </a>
        )}
        <ResultFiles scan={scan} />
        {canOperate.value && (
          <Act
            action={keep}
            work={async () => {
              const options = { params: { path: { id: scan.id } }, body: { kept: !scan.kept } };
              changed(await resultOf(api.PUT("/api/scans/{id}/keep", options)));
            }}
          >
            {scan.kept ? t("history.row.unkeep") : t("history.row.keep")}
          </Act>
        )}
      </div>
      <Failed failure={keep.failure} />
      {canOperate.value && links.reprocess !== null && !tooFew(scan) && <Reprocess scan={scan} />}
    </div>
  );
}
