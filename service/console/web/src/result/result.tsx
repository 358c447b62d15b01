import "./result.css";
import { useMemo, useRef, useState } from "preact/hooks";
import { Badge } from "../bar/status";
import type { Model, Scan } from "../net/api";
import { addressOf } from "../route";
import { first } from "../state/scans";
import { Failed } from "../ui/action";
import { WhatToDo } from "../ui/manual";
import { RecordingName } from "../scan/recording_name";
import { ToldRadius } from "../scan/told_radius";
import { pointAt } from "../view3d/along";
import { orderGradient } from "../view3d/order";
import type { Other, Place } from "../view3d/scene";
import { sentence } from "../words/sentence";
import { hasModel, isElsewhere, kindOf, outcome, underWay } from "../words/states";
import { counted, when } from "../words/units";
import { Compare } from "./compare";
import { Crossings } from "./crossings";
import { Findings } from "./findings";
import { Grasps } from "./grasps";
import { useResult } from "./load";
import { NewestResult } from "./newest";
import { Point } from "./point";
import { Strings } from "./strings";
import { Viewer, type Chosen } from "../viewer/viewer";

const LAYERS = ["strings", "cloud", "crossings", "labels", "room"] as const;

/** A scan's result: in 3D, and in words beside it. */
export function ResultScreen({ id }: { id: string | null }) {
  return id === null ? <NewestResult /> : <Result id={id} />;
}

function Result({ id }: { id: string }) {
  const loaded = useResult(id);
  const [chosen, setChosen] = useState<Chosen | null>(null);
  const [others, setOthers] = useState<readonly Other[]>([]);
  const { scan, model, cloud, views } = loaded;
  const content = useMemo(() => ({ model, cloud, views, others }), [model, cloud, views, others]);
  const drawn = useRef<HTMLDivElement>(null);
  const show = (place: Place) => {
    setChosen({ place, turn: true });
    drawn.current?.scrollIntoView({ block: "nearest" }); // on a narrow screen the picture is above the words
  };

  return (
    <div class="result">
      <div class="drawn" ref={drawn}>
        <Viewer
          content={content}
          elsewhere={scan !== null && isElsewhere(scan)}
          layers={LAYERS}
          chosen={chosen}
          picked={(place) => setChosen({ place: model === null ? place : onPoint(model, place), turn: false })}
          instead={scan?.links.preview}
        />
        <p class="small legend">
          First end <span style={{ background: orderGradient() }} /> last end. The rings point towards the last end; where
          a strand is under another, it is left out.
        </p>
      </div>
      <div class="beside">
        <h1>
          {model === null ? "Result" : counted(model.chains.length, "string")}
          {model !== null && `, ${counted(model.crossings.length, "crossing")}`}
        </h1>
        {scan !== null && (
          <p>
            <Badge look={outcome(scan).look}>{outcome(scan).word}</Badge> {kindOf(scan)}, {when(scan.created_at)}
            {model !== null && `, ${model.method}`}
          </p>
        )}
        {scan?.problem && (
          <p class="note bad">
            {sentence(scan.problem.detail)} <WhatToDo problem={scan.problem.type} />
          </p>
        )}
        {scan !== null && isElsewhere(scan) && scan.recording !== null && (
          <p class="note warn">
            ▲ <strong>This is what a recording shows</strong>
            <RecordingName id={scan.recording} />: not the table as it is now.
          </p>
        )}
        {scan !== null && <Newer than={scan} />}
        <Failed failure={loaded.failure} />
        {model !== null && scan !== null && (
          <>
            <ToldRadius scan={scan} />
            <Findings model={model} show={show} />
            {model.chains.length > 0 && (
              <>
                <Point model={model} place={chosen?.place ?? null} choose={setChosen} />
                <Strings model={model} show={show} />
                <Crossings model={model} show={show} />
                <Grasps model={model} show={show} />
              </>
            )}
            {scan.recording !== null && <Compare scan={scan} model={model} others={others} setOthers={setOthers} />}
          </>
        )}
      </div>
    </div>
  );
}

/** Says so where another scan has come since: nobody shall grasp by a table of before. */
function Newer({ than }: { than: Scan }) {
  const newest = first.value;
  if (newest === null || newest.id === than.id) return null;
  if (newest.recording !== null && newest.recording === than.recording) return null; // the same views
  // What works out an earlier scan again is of the table of then, however new it is.
  if (than.source === null && newest.created_at <= than.created_at) return null;
  const came = underWay(newest.state) ? "is under way" : `ended: ${outcome(newest).word}`;
  return (
    <p class="note warn">
      ▲ <strong>This is an earlier scan.</strong> A newer one of {when(newest.created_at)} {came}.{" "}
      <a href={hasModel(newest) ? addressOf("result", newest.id) : addressOf("scan")}>Look at that one</a>
    </p>
  );
}

/** A place on a string as the model's point that is nearest: of that, all is known. */
function onPoint(model: Model, place: Place): Place {
  const chain = place.kind === "point" ? model.chains.find((one) => one.id === place.chain) : undefined;
  if (place.kind !== "point" || chain === undefined) return place;
  return { ...place, s_m: chain.arc_length_m[pointAt(chain, place.s_m).index] ?? place.s_m };
}
