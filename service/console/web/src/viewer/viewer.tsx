import "./viewer.css";
import { useEffect, useRef, useState } from "preact/hooks";
import { cell } from "../state/cell";
import { lost } from "../state/freshness";
import { room } from "../state/room";
import type { Content, Layer, Place, View3D } from "../view3d/view3d";
import { Picture } from "../ui/picture";
import { Layers } from "./layers";

/** What a person looks at, and whether the view is to turn to it. */
export interface Chosen {
  place: Place;
  turn: boolean;
}

interface ViewerProps {
  content: Pick<Content, "model" | "cloud" | "views" | "others">;
  /** It was recorded at no table that is known here. */
  elsewhere?: boolean;
  /** What is shown at first. */
  layers: readonly Layer[];
  chosen?: Chosen | null;
  picked?: (place: Place) => void;
  /** Shown where the browser cannot draw in 3D. */
  instead?: string | null;
}

/** What is not where the strings are: when it is shown, the view goes back until all is in it. */
const FAR: readonly Layer[] = ["cameras", "arm"];
const TURN = Math.PI / 18;

/** The 3D view. Its code is fetched only now, behind all that must be seen at once; nothing in it can move the robot. */
export function Viewer({ content, elsewhere = false, layers, chosen = null, picked, instead = null }: ViewerProps) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const labels = useRef<HTMLDivElement>(null);
  const [view, setView] = useState<View3D | null>(null);
  const [failed, setFailed] = useState(false);
  const [shown, setShown] = useState<ReadonlySet<Layer>>(new Set(layers));
  const [fit, setFit] = useState(0);
  const onPick = useRef(picked);
  onPick.current = picked;
  const around = elsewhere ? null : room.value;
  const q_rad = elsewhere || lost.value ? null : (cell.value?.robot.q_rad ?? null);

  useEffect(() => {
    let open: View3D | null = null;
    let gone = false;
    const dark = matchMedia("(prefers-color-scheme: dark)");
    const follow = () => open?.scheme(dark.matches ? "dark" : "light");
    // The page is painted first: starting to draw in 3D takes the browser a moment.
    const soon = setTimeout(async () => {
      const { open3D, NoWebGLError } = await import("../view3d/view3d");
      if (gone || canvas.current === null || labels.current === null) return;
      try {
        open = open3D(canvas.current, labels.current, { picked: (place) => onPick.current?.(place) });
      } catch (error) {
        if (!(error instanceof NoWebGLError)) throw error;
        return setFailed(true);
      }
      follow();
      dark.addEventListener("change", follow);
      setView(open);
    });
    return () => {
      gone = true;
      clearTimeout(soon);
      dark.removeEventListener("change", follow);
      open?.dispose();
    };
  }, []);

  useEffect(() => view?.show({ ...content, room: around, q_rad }), [view, content, around]);
  useEffect(() => view?.layers(shown), [view, shown]);
  useEffect(() => {
    if (fit > 0) view?.look("fit");
  }, [view, fit]);
  useEffect(() => view?.arm(q_rad), [view, q_rad]);
  useEffect(() => {
    if (chosen === null) view?.mark(null);
    else if (chosen.turn) view?.focus(chosen.place);
    else view?.mark(chosen.place);
  }, [view, chosen]);

  const keys: Record<string, () => void> = {
    ArrowLeft: () => view?.rotate(TURN, 0),
    ArrowRight: () => view?.rotate(-TURN, 0),
    ArrowUp: () => view?.rotate(0, TURN),
    ArrowDown: () => view?.rotate(0, -TURN),
    "+": () => view?.zoom(1.25),
    "-": () => view?.zoom(0.8),
    "0": () => view?.look("fit"),
  };

  return (
    <div class="viewer">
      <div class="row tools" role="group" aria-label="From where to look">
        <button type="button" onClick={() => view?.look("fit")}>
          All
        </button>
        <button type="button" onClick={() => view?.look("top")}>
          From above
        </button>
        <button type="button" onClick={() => view?.look("side")}>
          From the side
        </button>
        <button type="button" aria-label="Nearer" onClick={() => view?.zoom(1.25)}>
          +
        </button>
        <button type="button" aria-label="Farther" onClick={() => view?.zoom(0.8)}>
          -
        </button>
      </div>
      <div class="scene">
        {failed && (
          <div class="instead">
            <p class="note warn">This browser cannot draw in 3D. All that is known is in words beside this.</p>
            {instead !== null && <Picture src={instead} alt="The strings from above, and their heights" />}
          </div>
        )}
        <canvas
          ref={canvas}
          tabIndex={0}
          role="application"
          aria-label="The strings in 3D. Arrow keys turn, plus and minus come nearer or go farther, 0 shows all."
          onKeyDown={(event) => {
            const act = keys[event.key];
            if (act === undefined) return;
            event.preventDefault();
            act();
          }}
        />
        <div ref={labels} class="labels3d" aria-hidden="true" />
      </div>
      <Layers
        there={layersOf(content, around !== null, q_rad !== null)}
        shown={shown}
        set={(wanted) => {
          setShown(wanted);
          if (FAR.some((layer) => wanted.has(layer) && !shown.has(layer))) setFit((before) => before + 1);
        }}
      />
    </div>
  );
}

/** The layers that there is something of. */
function layersOf({ model, cloud, views }: ViewerProps["content"], room: boolean, arm: boolean): ReadonlySet<Layer> {
  const there: Layer[] = ["labels"];
  if (model !== null && model.chains.length > 0) there.push("strings");
  if (model !== null && model.crossings.length > 0) there.push("crossings");
  if (model !== null && model.grasps.length > 0) there.push("grasps");
  if (cloud !== null) there.push("cloud");
  if (views.length > 0) there.push("cameras");
  if (room) there.push("room");
  if (arm) there.push("arm");
  return new Set(there);
}
