import type { Model, Scan } from "../net/api";
import type { Other, Target, ViewPose } from "../view3d/scene";
import type { View3D } from "../view3d/view3d";
import type { Selection } from "../viewer/viewer";
import { Changes, type Earlier } from "./changes";
import { Compare } from "./compare";
import { Files } from "./tools/files";
import { ViewPictures } from "./view_pictures";

interface MoreProps {
  scan: Scan;
  model: Model;
  views: readonly ViewPose[];
  view: View3D | null;
  earlier: Earlier | null;
  setEarlier: (earlier: Earlier | null) => void;
  others: readonly Other[];
  setOthers: (others: readonly Other[]) => void;
  selection: Selection | null;
  show: (target: Target) => void;
}

/** What follows the lists of a result: changes, other methods, pictures and files. */
export function More({ scan, model, views, view, earlier, setEarlier, others, setOthers, selection, show }: MoreProps) {
  return (
    <>
      <Changes scan={scan} earlier={earlier} setEarlier={setEarlier} show={show} />
      {scan.recording !== null && <Compare scan={scan} model={model} others={others} setOthers={setOthers} />}
      <ViewPictures model={model} views={views} selection={selection} show={show} />
      <Files scan={scan} model={model} view={view} />
    </>
  );
}
