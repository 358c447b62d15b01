import { useState } from "preact/hooks";
import { api, told, type Model, type Scan } from "../net/api";
import { request } from "../net/request";
import type { Failure } from "../ui/action";
import { useAsked } from "../ui/asked";
import { hasModel } from "../words/states";
import type { ViewPose } from "../view3d/scene";

/** A large cloud over a slow network takes its time. */
const LONG = { fetch: (asked: Request) => request(asked, 120) };

/** What there is to be seen of a scan; what has not come yet is null or empty. */
interface Loaded {
  scan: Scan | null;
  model: Model | null;
  cloud: ArrayBuffer | null;
  views: readonly ViewPose[];
}

const NOTHING: Loaded = { scan: null, model: null, cloud: null, views: [] };

/** The model of a scan. */
export async function loadModel(id: string): Promise<Model> {
  const model: unknown = await told(api.GET("/api/scans/{id}/model", { params: { path: { id } }, ...LONG }));
  return model as Model; // the client's types make lists of any length of points
}

/** Loads a scan's results one after the other, the model first. */
export function useResult(id: string): Loaded & { failure: Failure | null } {
  const [loaded, setLoaded] = useState(NOTHING);
  const add = (part: Partial<Loaded>) => setLoaded((before) => ({ ...before, ...part }));
  const params = { path: { id } };

  async function load(): Promise<void> {
    const scan = await told(api.GET("/api/scans/{id}", { params: { ...params } }));
    add({ scan });
    if (!hasModel(scan)) return;
    add({ model: await loadModel(id) });
    add({ views: (await told(api.GET("/api/scans/{id}/views", { params }))).views });
    add({ cloud: await told(api.GET("/api/scans/{id}/cloud.ply", { params, parseAs: "arrayBuffer", ...LONG })) });
  }

  const failure = useAsked(load, () => undefined, [id]);
  return { ...loaded, failure };
}
