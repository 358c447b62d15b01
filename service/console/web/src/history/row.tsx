import { useEffect, useRef, useState } from "preact/hooks";
import { Badge } from "../bar/status";
import { api, told, type Scan } from "../net/api";
import { addressOf } from "../route";
import { RecordingName } from "../scan/recording_name";
import { operates } from "../state/session";
import { Act, Failed, useAction } from "../ui/action";
import { Picture } from "../ui/picture";
import { WhyEnded } from "../ui/why_ended";
import { Warnings } from "../ui/warnings";
import { hasModel, isElsewhere, kindOf, outcome, tooFew } from "../words/states";
import { counted, mm, when } from "../words/units";
import { Again } from "./again";

interface RowProps {
  scan: Scan;
  /** It was told anew. */
  changed: (scan: Scan) => void;
}

/** A scan of the list; opened, all that can be done with it. */
export function Row({ scan, opened, changed }: RowProps & { opened: boolean }) {
  const [open, setOpen] = useState(opened);
  const row = useRef<HTMLLIElement>(null);
  useEffect(() => {
    if (opened) row.current?.scrollIntoView({ block: "center" });
  }, []);
  const { word, look } = outcome(scan);
  const name = `${kindOf(scan)}, ${when(scan.created_at)}`;
  return (
    <li ref={row}>
      <button type="button" class="headline" aria-expanded={open} onClick={() => setOpen(!open)}>
        {hasModel(scan) ? (
          <Picture src={scan.links.thumbnail ?? ""} alt="" class="thumbnail" />
        ) : (
          <span class="picture thumbnail">no result</span>
        )}
        <span class="what">
          <strong>{name}</strong>
          <span>
            {scan.summary?.chains ? `${counted(scan.summary.chains, "string")}, ${counted(scan.summary.crossings, "crossing")}, ` : ""}
            {scan.method}
            {scan.string_radius_m === null ? "" : `, radius ${mm(scan.string_radius_m)}`}
            {scan.asked_by === null ? "" : `, by ${scan.asked_by}`}
            {scan.kept ? ", kept" : ""}
          </span>
        </span>
        <Badge look={look}>{word}</Badge>
      </button>
      {open && <Details scan={scan} name={name} changed={changed} />}
    </li>
  );
}

function Details({ scan, name, changed }: RowProps & { name: string }) {
  const keep = useAction();
  const { links, problem, summary } = scan;
  const files: [string, string | null, string][] = [
    ["Model (JSON)", links.model, `${scan.id}.json`],
    ["Grasps (JSON)", links.grasps, `${scan.id}-grasps.json`],
    ["Points (PLY)", links.cloud, `${scan.id}.ply`],
    ["Picture (PNG)", links.preview, `${scan.id}.png`],
    ["Recording (MCAP)", links.recording, `${scan.id}.mcap`],
  ];
  return (
    <div class="details" role="group" aria-label={name}>
      <WhyEnded state={scan.state} problem={problem} />
      <Warnings warnings={summary?.warnings ?? []} />
      <p class="small">
        {scan.string_radius_m === null && (hasModel(scan) ? "The radius was measured; " : "The radius was to be measured; ")}
        {scan.source !== null && (
          <>
            works out again <a href={addressOf("history", scan.source)}>an earlier scan</a>;{" "}
          </>
        )}
        {scan.id}
        {isElsewhere(scan) && scan.recording !== null && <RecordingName id={scan.recording} />}
      </p>
      <div class="row">
        {hasModel(scan) && (
          <a class="button main" href={addressOf("result", scan.id)}>
            Look at the result
          </a>
        )}
        {files.map(
          ([label, address, file]) =>
            address !== null && (
              <a key={label} class="button" href={address} download={file}>
                {label}
              </a>
            ),
        )}
        {operates.value && (
          <Act
            action={keep}
            work={async () => {
              const asked = { params: { path: { id: scan.id } }, body: { kept: !scan.kept } };
              changed(await told(api.PUT("/api/scans/{id}/keep", asked)));
            }}
          >
            {scan.kept ? "Keep no longer" : "Keep for ever"}
          </Act>
        )}
      </div>
      <Failed failure={keep.failure} />
      {operates.value && links.reprocess !== null && !tooFew(scan) && <Again scan={scan} />}
    </div>
  );
}
