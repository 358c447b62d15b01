import type { Scan } from "../net/api";
import { addressOf } from "../route";
import { RadiusWarning } from "../scan/radius_warning";
import { RecordingName } from "../scan/recording_name";
import { calibration } from "../state/cell";
import { latestOriginal } from "../state/scans";
import { when } from "../texts/format";
import { problemDetail } from "../texts/problem";
import { hasModel, isActive, isElsewhere, outcome } from "../texts/states";
import { rich } from "../texts/translate";
import { strong } from "../ui/action";
import { WhatToDo } from "../ui/manual";
import { onDemand } from "../ui/on_demand";

const { Component: SourceNote } = onDemand(async () => (await import("./source_note")).SourceNote);

/** What a person must know about the scan as a whole: whether it shows the table as it is now. */
export function ScanNotes({ scan }: { scan: Scan }) {
  return (
    <>
      {scan.problem && (
        <p class="note bad">
          {problemDetail(scan.problem)} <WhatToDo problem={scan.problem.type} />
        </p>
      )}
      {isElsewhere(scan) && scan.recording !== null && (
        <p class="note warn">{rich("result.recording", { name: <RecordingName id={scan.recording} />, strong })}</p>
      )}
      {scan.source !== null && <SourceNote source={scan.source} />}
      <NewerScanNote than={scan} />
      <CalibrationNote scan={scan} />
      {hasModel(scan) && <RadiusWarning scan={scan} />}
    </>
  );
}

/** Warns that nobody knows how good the calibration of a scan is: the strings may be right, and yet be elsewhere. */
function CalibrationNote({ scan }: { scan: Scan }) {
  const used = calibration.value?.calibration;
  if (scan.simulated !== false || scan.calibration_sha256 === null || !hasModel(scan)) return null;
  if (!used || used.sha256 !== scan.calibration_sha256 || used.verdict !== null) return null;
  const link = (content: preact.ComponentChildren) => <a href={addressOf("calibration")}>{content}</a>;
  return <p class="note warn">{rich("result.calibration_not_judged", { strong, link })}</p>;
}

/** Return the newest scan if its views are newer than those of a scan, else null. */
export function newerScan(than: Scan): Scan | null {
  const newest = latestOriginal.value;
  if (newest === null || newest.id === than.id) return null;
  if (newest.recording !== null && newest.recording === than.recording) return null; // the same views
  // A repeated recognition shows the table at the time of its source, no matter when it was made.
  if (than.source === null && newest.created_at <= than.created_at) return null;
  return newest;
}

/** Warns that there is a newer scan: the table may have changed since this one. */
function NewerScanNote({ than }: { than: Scan }) {
  const newest = newerScan(than);
  if (newest === null) return null;
  const address = hasModel(newest) ? addressOf("result", newest.id) : addressOf("scan");
  const link = (content: preact.ComponentChildren) => <a href={address}>{content}</a>;
  const values = { when: when(newest.created_at), strong, link };
  return (
    <p class="note warn">
      {isActive(newest.state)
        ? rich("result.earlier_running", values)
        : rich("result.earlier_ended", { ...values, outcome: outcome(newest).word })}
    </p>
  );
}
