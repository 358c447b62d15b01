import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { Badge } from "../bar/status";
import type { Model, Scan } from "../net/api";
import { when } from "../texts/format";
import { isActive, isElsewhere, kindOf, outcome } from "../texts/states";
import { rich, t } from "../texts/translate";
import { Failed } from "../ui/action";
import { pointAt } from "../view3d/strings/arc_length";
import { orderGradient } from "../view3d/strings/order_colours";
import type { Other, Target } from "../view3d/scene";
import type { View3D } from "../view3d/view3d";
import { SimulatedMark } from "../ui/simulated";
import { onDemand } from "../ui/on_demand";
import { type Selection, Viewer } from "../viewer/viewer";
import type { Earlier } from "./changes";
import { Crossings } from "./crossings";
import { Findings } from "./findings";
import { Grasps } from "./grasps";
import { listedGrasps } from "./data/listed_grasps";
import { latest } from "../state/scans";
import { NewestResult } from "./newest_result";
import { measuredTo, type Position, positionOf } from "./tools/position";
import { keepBelowBar, reveal, revealBeside } from "./reveal";
import { ScanNotes } from "./scan_notes";
import { ToSelectedGrasp } from "./selected_grasp";
import { SelectedPosition } from "./tools/selected_position";
import { Strings } from "./strings";
import { useHeights } from "./data/use_heights";
import { useReach } from "./data/use_reach";
import { useResult } from "./data/use_result";
import { Verdict } from "./verdict";

const { Component: Progress } = onDemand(async () => (await import("../scan/progress")).Progress);
const { Component: Measuring } = onDemand(async () => (await import("./tools/measuring")).Measuring);
const { Component: HeightLegend } = onDemand(async () => (await import("./height_legend")).HeightLegend);
const { Component: More } = onDemand(async () => (await import("./more")).More);
const LAYERS = ["strings", "cloud", "crossings", "labels", "geometry"] as const;

/** The result of a scan: in 3D, and as lists beside it. */
export function ResultScreen({ id }: { id: string | null }) {
  return id === null ? <NewestResult /> : <Result id={id} />;
}

function Result({ id }: { id: string }) {
  const loaded = useResult(id);
  const [selection, select] = useState<Selection | null>(null);
  const [earlier, setEarlier] = useState<Earlier | null>(null);
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
  const [from, measureFrom] = useState<Position | null>(null);
  const to = measuredTo(from, selection?.target ?? null, model);
  const measured = useMemo(() => from && { from: from.point, to: to?.point ?? null }, [from, to?.name]);
  const content = useMemo(
    () => ({ model, grasps, cloud, views, others, heights: map, measured, earlier: earlier?.model ?? null }),
    [model, grasps, cloud, views, others, map, measured, earlier],
  );
  const [view, setView] = useState<View3D | null>(null);
  const drawn = useRef<HTMLDivElement>(null);
  const selected = useRef<HTMLDivElement>(null);
  useEffect(() => {
    // A position that was picked in the picture is described beside it.
    if (selection === null || selection.turn || model === null || positionOf(selection.target, model) === null) return;
    if (selected.current !== null) revealBeside(selected.current);
  }, [selection]);
  useEffect(() => (drawn.current === null ? undefined : keepBelowBar(drawn.current)), []);
  const revealPicture = () => {
    const canvas = drawn.current?.querySelector("canvas");
    if (canvas) reveal(canvas); // on a narrow screen the picture is above the lists
  };
  const show = (target: Target) => {
    select({ target, turn: true });
    revealPicture();
  };

  return (
    <div class="result">
      {model !== null && scan !== null ? (
        <Verdict scan={scan} model={model} />
      ) : (
        <header class="verdict">
          <h1>{t("result.title")}</h1>
          {scan !== null && <WithoutModel scan={latest.value?.id === id ? latest.value : scan} />}
        </header>
      )}
      <div class="doubts">
        {scan !== null && <ScanNotes scan={scan} />}
        <Failed failure={loaded.failure} />
        {model !== null && <Findings model={model} views={views} show={show} />}
      </div>
      <div class="drawn" ref={drawn}>
        <Viewer
          content={content}
          elsewhere={scan !== null && isElsewhere(scan)}
          otherGripper={reach.sameGripper === false}
          layers={LAYERS}
          onDemand={scan?.links.height_map ? { layer: "heights", set: heights.show } : null}
          selection={selection}
          picked={(target) => select({ target: model === null ? target : onPoint(model, target), turn: false })}
          opened={setView}
          fallback={scan?.links.preview}
        />
        <div class="legends">
          <p class="small legend">
            {rich("result.legend", { gradient: <span style={{ background: orderGradient() }} /> })}{" "}
            {model !== null && model.chains.length > 0 && t("result.point.none")}
          </p>
          {map !== null && <HeightLegend map={map} />}
          <Failed failure={heights.failure} />
        </div>
      </div>
      {model !== null && scan !== null && (
        <div class="selected" ref={selected}>
          {from !== null && <Measuring scan={scan} from={from} to={to} end={() => measureFrom(null)} />}
          {grasp !== null && <ToSelectedGrasp id={grasp} />}
          {selection !== null && (
            <SelectedPosition
              scan={scan}
              model={model}
              target={selection.target}
              select={select}
              measureFrom={(position) => {
                measureFrom(position);
                revealPicture(); // where the second point is selected, and the distance is written
              }}
            />
          )}
        </div>
      )}
      {model !== null && scan !== null && (
        <div class="beside">
          {model.chains.length > 0 && (
            <>
              <Strings model={model} show={show} />
              <Crossings model={model} show={show} />
              <Grasps scan={scan} model={model} listed={grasps} reach={reach} selection={selection} select={select} show={show} />
            </>
          )}
          <More
            scan={scan}
            model={model}
            views={views}
            view={view}
            earlier={earlier}
            setEarlier={(chosen) => {
              setEarlier(chosen);
              if (chosen !== null) revealPicture();
            }}
            others={others}
            setOthers={setOthers}
            selection={selection}
            show={show}
          />
        </div>
      )}
    </div>
  );
}

/** The progress of a scan that runs, or the outcome of one without a model. */
function WithoutModel({ scan }: { scan: Scan }) {
  if (isActive(scan.state)) return <Progress scan={scan} />;
  const { word, tone } = outcome(scan);
  return (
    <p>
      <Badge tone={tone}>{word}</Badge> <SimulatedMark scan={scan} />{" "}
      {t("common.kind_and_time", { kind: kindOf(scan), when: when(scan.created_at) })}
    </p>
  );
}

/** Move a target on a string to the nearest point of the model, where all figures are known. */
function onPoint(model: Model, target: Target): Target {
  const chain = target.kind === "point" ? model.chains.find((one) => one.id === target.chain) : undefined;
  if (target.kind !== "point" || chain === undefined) return target;
  return { ...target, s_m: chain.arc_length_m[pointAt(chain, target.s_m).index] ?? target.s_m };
}
