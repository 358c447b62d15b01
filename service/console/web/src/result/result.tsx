import { useMemo, useRef, useState } from "preact/hooks";
import { Badge } from "../bar/status";
import type { Model, Scan } from "../net/api";
import { addressOf } from "../route";
import { RadiusWarning } from "../scan/radius_warning";
import { RecordingName } from "../scan/recording_name";
import { latestOriginal } from "../state/scans";
import { when } from "../texts/format";
import { problemDetail } from "../texts/problem";
import { foundText, hasModel, isActive, isElsewhere, kindOf, outcome } from "../texts/states";
import { rich, t } from "../texts/translate";
import { Failed, strong } from "../ui/action";
import { WhatToDo } from "../ui/manual";
import { pointAt } from "../view3d/arc_length";
import { orderGradient } from "../view3d/order_colours";
import type { Other, Target } from "../view3d/scene";
import { type Selection, Viewer } from "../viewer/viewer";
import { Compare } from "./compare";
import { Crossings } from "./crossings";
import { Findings } from "./findings";
import { Grasps } from "./grasps";
import { HeightLegend } from "./height_legend";
import { listedGrasps } from "./listed_grasps";
import { NewestResult } from "./newest_result";
import { SelectedPoint } from "./selected_point";
import { Strings } from "./strings";
import { useHeights } from "./use_heights";
import { useReach } from "./use_reach";
import { useResult } from "./use_result";

const LAYERS = ["strings", "cloud", "crossings", "labels", "geometry"] as const;

/** The result of a scan: in 3D, and as lists beside it. */
export function ResultScreen({ id }: { id: string | null }) {
  return id === null ? <NewestResult /> : <Result id={id} />;
}

function Result({ id }: { id: string }) {
  const loaded = useResult(id);
  const [selection, select] = useState<Selection | null>(null);
  const [others, setOthers] = useState<readonly Other[]>([]);
  const { scan, model, cloud, views } = loaded;
  const heights = useHeights(scan);
  const { map } = heights;
  const reach = useReach(id, model);
  const grasp = selection?.target.kind === "grasp" ? selection.target.id : null;
  const grasps = useMemo(
    () => (model === null ? [] : listedGrasps(model, reach.grasps, grasp)),
    [model, reach.grasps, grasp],
  );
  const content = useMemo(
    () => ({ model, grasps, cloud, views, others, heights: map }),
    [model, grasps, cloud, views, others, map],
  );
  const drawn = useRef<HTMLDivElement>(null);
  const show = (target: Target) => {
    select({ target, turn: true });
    drawn.current?.scrollIntoView({ block: "nearest" }); // on a narrow screen the picture is above the lists
  };

  return (
    <div class="result">
      <div class="drawn" ref={drawn}>
        <Viewer
          content={content}
          elsewhere={scan !== null && isElsewhere(scan)}
          otherGripper={reach.sameGripper === false}
          layers={LAYERS}
          onDemand={scan?.links.height_map ? { layer: "heights", set: heights.show } : null}
          selection={selection}
          picked={(target) => select({ target: model === null ? target : onPoint(model, target), turn: false })}
          fallback={scan?.links.preview}
        />
        <p class="small legend">
          {rich("result.legend", { gradient: <span style={{ background: orderGradient() }} /> })}
        </p>
        {map !== null && <HeightLegend map={map} />}
        <Failed failure={heights.failure} />
      </div>
      <div class="beside">
        <h1>{model === null ? t("result.title") : foundText(model.chains.length, model.crossings.length)}</h1>
        {scan !== null && <Description scan={scan} model={model} />}
        {scan?.problem && (
          <p class="note bad">
            {problemDetail(scan.problem)} <WhatToDo problem={scan.problem.type} />
          </p>
        )}
        {scan !== null && isElsewhere(scan) && scan.recording !== null && (
          <p class="note warn">{rich("result.recording", { name: <RecordingName id={scan.recording} />, strong })}</p>
        )}
        {scan !== null && <NewerScanNote than={scan} />}
        <Failed failure={loaded.failure} />
        {model !== null && scan !== null && (
          <>
            <RadiusWarning scan={scan} />
            {loaded.isEarlier && <EarlierReleaseNote scan={scan} />}
            <Findings model={model} views={views} show={show} />
            {model.chains.length > 0 && (
              <>
                <SelectedPoint model={model} target={selection?.target ?? null} select={select} />
                <Strings model={model} show={show} />
                <Crossings model={model} show={show} />
                <Grasps model={model} listed={grasps} reach={reach} selection={selection} select={select} show={show} />
              </>
            )}
            {scan.recording !== null && <Compare scan={scan} model={model} others={others} setOthers={setOthers} />}
          </>
        )}
      </div>
    </div>
  );
}

function Description({ scan, model }: { scan: Scan; model: Model | null }) {
  const { word, tone } = outcome(scan);
  const values = { kind: kindOf(scan), when: when(scan.created_at) };
  return (
    <p>
      <Badge tone={tone}>{word}</Badge>{" "}
      {model === null
        ? t("common.kind_and_time", values)
        : t("scan.last.description", { ...values, method: t(`method.${scan.method}.name`) })}
    </p>
  );
}

/** Says that an earlier release of the service made the result. */
function EarlierReleaseNote({ scan }: { scan: Scan }) {
  const link = (content: preact.ComponentChildren) => <a href={addressOf("history", scan.id)}>{content}</a>;
  return (
    <p class="note warn">
      {rich("result.earlier_release", { strong })}{" "}
      {scan.links.reprocess !== null && rich("result.earlier_release_again", { link })}
    </p>
  );
}

/** Warns that there is a newer scan: the table may have changed since this one. */
function NewerScanNote({ than }: { than: Scan }) {
  const newest = latestOriginal.value;
  if (newest === null || newest.id === than.id) return null;
  if (newest.recording !== null && newest.recording === than.recording) return null; // the same views
  // A repeated recognition shows the table at the time of its source, no matter when it was made.
  if (than.source === null && newest.created_at <= than.created_at) return null;
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

/** Move a target on a string to the nearest point of the model, where all figures are known. */
function onPoint(model: Model, target: Target): Target {
  const chain = target.kind === "point" ? model.chains.find((one) => one.id === target.chain) : undefined;
  if (target.kind !== "point" || chain === undefined) return target;
  return { ...target, s_m: chain.arc_length_m[pointAt(chain, target.s_m).index] ?? target.s_m };
}
