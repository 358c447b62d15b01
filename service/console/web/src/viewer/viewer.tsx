import type { ComponentChildren } from "preact";
import { useEffect, useRef, useState } from "preact/hooks";
import { joints_rad } from "../state/arm";
import { geometry } from "../state/geometry";
import { t } from "../texts/translate";
import type { Content, Layer, Target, View3D } from "../view3d/view3d";
import { Picture } from "../ui/picture";
import { Layers } from "./layers";

/** The selected target, and whether the view turns to it. */
export interface Selection {
  target: Target;
  turn: boolean;
}

/** Parts of the content that only some screens have. */
type OptionalContent = "heights" | "grasps" | "measured" | "earlier" | "planned" | "lens" | "viewClouds";

interface ViewerProps {
  content: Pick<Content, "model" | "cloud" | "views" | "others"> & Partial<Pick<Content, OptionalContent>>;
  /** It was not recorded at the table of this cell. */
  elsewhere?: boolean;
  /** Its grasps are for another gripper than the configured one. */
  otherGripper?: boolean;
  /** Layers that are shown at first. */
  layers: readonly Layer[];
  /** A layer whose content is loaded when it is shown, and what to call then and when it is hidden. */
  onDemand?: { layer: Layer; set: (shown: boolean) => void } | null;
  selection?: Selection | null;
  picked?: (target: Target) => void;
  /** Called with the 3D view once it is open. */
  opened?: (view: View3D) => void;
  /** Image for browsers that cannot draw in 3D. */
  fallback?: string | null;
  /** Drawn over the scene. */
  children?: ComponentChildren;
}

/** Layers far from the strings: when one is shown, the view zooms out to contain it. */
const FAR: readonly Layer[] = ["cameras", "arm"];
const TURN = Math.PI / 18;
const NONE: Pick<Content, OptionalContent> = { heights: null, grasps: [], measured: null, earlier: null, planned: null, lens: null, viewClouds: [] };

/** The 3D view. Its code is loaded after the rest of the page. Nothing in it can move the robot. */
export function Viewer(props: ViewerProps) {
  const { content, elsewhere = false, otherGripper = false, layers, onDemand = null } = props;
  const { selection = null, picked, fallback = null } = props;
  const canvas = useRef<HTMLCanvasElement>(null);
  const labels = useRef<HTMLDivElement>(null);
  const [view, setView] = useState<View3D | null>(null);
  const [failed, setFailed] = useState(false);
  const [shown, setShown] = useState<ReadonlySet<Layer>>(new Set(layers));
  const [fit, setFit] = useState(0);
  const onPick = useRef(picked);
  onPick.current = picked;
  const around = elsewhere ? null : geometry.value;
  const gripper = otherGripper ? null : (geometry.value?.gripper ?? null);
  const q_rad = elsewhere ? null : joints_rad.value;

  useEffect(() => {
    let open: View3D | null = null;
    let gone = false;
    const dark = matchMedia("(prefers-color-scheme: dark)");
    const follow = () => open?.scheme(dark.matches ? "dark" : "light");
    // The page is painted first, because starting WebGL takes a moment.
    const soon = setTimeout(async () => {
      const { open3D, NoWebGLError } = await import("../view3d/view3d");
      if (gone || canvas.current === null || labels.current === null) return;
      try {
        open = open3D(canvas.current, labels.current, { picked: (target) => onPick.current?.(target) });
      } catch (error) {
        if (!(error instanceof NoWebGLError)) throw error;
        return setFailed(true);
      }
      follow();
      dark.addEventListener("change", follow);
      setView(open);
      props.opened?.(open);
    });
    return () => {
      gone = true;
      clearTimeout(soon);
      dark.removeEventListener("change", follow);
      open?.dispose();
    };
  }, []);

  useEffect(
    () => view?.show({ ...NONE, ...content, geometry: around, gripper, q_rad }),
    [view, content, around, gripper],
  );
  useEffect(() => view?.layers(shown), [view, shown]);
  useEffect(() => {
    if (fit > 0) view?.viewFrom("fit");
  }, [view, fit]);
  useEffect(() => view?.arm(q_rad), [view, q_rad]);
  useEffect(() => {
    if (selection === null) view?.mark(null);
    else if (selection.turn) view?.focus(selection.target);
    else view?.mark(selection.target);
    // The other grasps, to compare with.
    if (selection?.target.kind === "grasp") setShown((before) => new Set([...before, "grasps"]));
  }, [view, selection]);

  const keys: Record<string, () => void> = {
    ArrowLeft: () => view?.rotate(TURN, 0),
    ArrowRight: () => view?.rotate(-TURN, 0),
    ArrowUp: () => view?.rotate(0, TURN),
    ArrowDown: () => view?.rotate(0, -TURN),
    "+": () => view?.zoom(1.25),
    "-": () => view?.zoom(0.8),
    "0": () => view?.viewFrom("fit"),
  };

  return (
    <div class="viewer">
      <div class="row tools" role="group" aria-label={t("viewer.tools")}>
        <button type="button" onClick={() => view?.viewFrom("fit")}>
          {t("viewer.fit")}
        </button>
        <button type="button" onClick={() => view?.viewFrom("top")}>
          {t("viewer.top")}
        </button>
        <button type="button" onClick={() => view?.viewFrom("side")}>
          {t("viewer.side")}
        </button>
        <button type="button" aria-label={t("viewer.zoom_in")} onClick={() => view?.zoom(1.25)}>
          +
        </button>
        <button type="button" aria-label={t("viewer.zoom_out")} onClick={() => view?.zoom(0.8)}>
          -
        </button>
      </div>
      <div class="scene">
        {failed && (
          <div class="fallback">
            <p class="note warn">{t("viewer.no_3d")}</p>
            {fallback !== null && <Picture src={fallback} alt={t("viewer.preview")} />}
          </div>
        )}
        <canvas
          ref={canvas}
          tabIndex={0}
          role="application"
          aria-label={t("viewer.canvas")}
          onKeyDown={(event) => {
            const act = keys[event.key];
            if (act === undefined) return;
            event.preventDefault();
            act();
          }}
        />
        <div ref={labels} class="labels3d" aria-hidden="true" />
        {props.children}
      </div>
      <Layers
        available={layersOf(content, around !== null, q_rad !== null, onDemand?.layer)}
        shown={shown}
        set={(next) => {
          setShown(next);
          if (onDemand !== null) onDemand.set(next.has(onDemand.layer));
          if (FAR.some((layer) => next.has(layer) && !shown.has(layer))) setFit((before) => before + 1);
        }}
      />
    </div>
  );
}

/** Return the layers that have content, or get it on demand. */
function layersOf(
  { model, cloud, views, planned, viewClouds }: ViewerProps["content"],
  around: boolean,
  arm: boolean,
  onDemand: Layer | undefined,
): ReadonlySet<Layer> {
  const available: Layer[] = ["labels"];
  if (model !== null && model.chains.length > 0) available.push("strings");
  if (model !== null && model.crossings.length > 0) available.push("crossings");
  if (model !== null && model.grasps.length > 0) available.push("grasps");
  if (cloud !== null || viewClouds?.length) available.push("cloud");
  if (views.length > 0 || planned) available.push("cameras");
  if (around) available.push("geometry");
  if (arm) available.push("arm");
  if (onDemand !== undefined) available.push(onDemand);
  return new Set(available);
}
