import { useMemo } from "preact/hooks";
import { api, resultOf, type Model, type Plan, type Scan } from "../net/api";
import { cell } from "../state/cell";
import { geometry } from "../state/geometry";
import { t } from "../texts/translate";
import { Picture } from "../ui/picture";
import { useLoaded } from "../ui/use_loaded";
import type { CameraPose, Lens, PlannedPath } from "../view3d/scene";
import { Viewer } from "../viewer/viewer";
import { useViewClouds } from "./use_view_clouds";

const LAYERS = ["cloud", "cameras", "arm", "labels", "geometry", "strings", "crossings"] as const;

interface CellViewProps {
  /** The live scan that runs, or has just ended; null: none. */
  scan: Scan | null;
  /** What a scan would do. It is drawn as long as the plan of the scan is not known. */
  checked: Plan | null;
  /** The model of the scan, once it is known. */
  model: Model | null;
}

/** The cell in 3D, before, during and after a scan: arm, camera, viewpoints, and the points of each view as it arrives. */
export function CellView({ scan, checked, model }: CellViewProps) {
  const isPlanned = scan?.mode === "live" && ["preflight", "scanning", "processing"].includes(scan.state);
  const plan = useLoaded(scan?.id ?? null, isPlanned, planOf) ?? checked;
  const arrived = useViewClouds(scan);
  const camera = geometry.value?.camera;
  const T_flange_camera = cell.value?.calibration?.T_flange_camera;

  const path = useMemo(() => pathOf(plan, camera), [plan, camera]);
  const lens = useMemo(() => (camera && T_flange_camera ? ({ ...camera, T_flange_camera } as Lens) : null), [
    camera,
    T_flange_camera?.flat().join(),
  ]);
  const content = useMemo(() => {
    const { indices, clouds } = arrived;
    const isDone = ({ index }: CameraPose) => indices.includes(index);
    const planned: PlannedPath | null = path.length > 0 ? { views: path.filter((view) => !isDone(view)), path } : null;
    return { model, cloud: null, views: path.filter(isDone), others: [], planned, lens, viewClouds: clouds };
  }, [model, path, arrived, lens]);

  const done = path.filter(({ index }) => arrived.indices.includes(index)); // in the order of the moves
  const newest = done.at(-1)?.index ?? arrived.indices.at(-1);
  return (
    <section class="cell-view" aria-label={t("cell_view.region")}>
      <Viewer content={content} layers={LAYERS}>
        {scan !== null && newest !== undefined && (
          <figure class="newest">
            <Picture src={`/api/scans/${scan.id}/views/${newest}.png`} alt={t("scan.views.alt", { index: newest })} />
            <figcaption>{t("cell_view.newest", { index: newest })}</figcaption>
          </figure>
        )}
      </Viewer>
    </section>
  );
}

async function planOf(id: string): Promise<Plan> {
  return resultOf(api.GET("/api/scans/{id}/plan", { params: { path: { id } } }));
}

/** Return the reachable viewpoints of a plan in the order of the path. */
function pathOf(plan: Plan | null, camera: Omit<Lens, "T_flange_camera"> | undefined): CameraPose[] {
  if (plan === null || camera === undefined) return [];
  return plan.legs.flatMap(({ view }) => {
    const viewpoint = plan.viewpoints.find(({ index }) => index === view);
    if (viewpoint === undefined) return [];
    return [{ ...camera, index: viewpoint.index, T_base_camera: viewpoint.T_base_camera }];
  });
}
