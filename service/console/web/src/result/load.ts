import { useEffect, useState } from "preact/hooks";
import { api, told, type Model, type Scan } from "../net/api";
import { request } from "../net/request";
import { failureOf, type Failure } from "../ui/action";
import { hasModel } from "../words/states";
import type { ViewPose } from "../view3d/scene";

/** A large cloud over a slow network takes its time. */
const LONG = { fetch: (asked: Request) => request(asked, 120) };

/** What there is to be seen of a scan; what has not come yet is null or empty. */
export interface Loaded {
  scan: Scan | null;
  model: Model | null;
  cloud: ArrayBuffer | null;
  views: readonly ViewPose[];
  failure: Failure | null;
}

const NOTHING: Loaded = { scan: null, model: null, cloud: null, views: [], failure: null };

/** The model of a scan. */
export async function loadModel(id: string): Promise<Model> {
  const model: unknown = await told(api.GET("/api/scans/{id}/model", { params: { path: { id } }, ...LONG }));
  return model as Model; // the client's types make lists of any length of points
}

/** Loads a scan's results, the model first; null: there is none to load. */
export function useResult(id: string | null): Loaded {
  const [loaded, setLoaded] = useState(NOTHING);
  useEffect(() => {
    if (id === null) return setLoaded(NOTHING);
    let wanted = true;
    const add = (part: Partial<Loaded>) => wanted && setLoaded((before) => ({ ...before, ...part }));
    const params = { path: { id } };
    void (async () => {
      try {
        const scan = await told(api.GET("/api/scans/{id}", { params: { ...params } }));
        add({ scan });
        if (!hasModel(scan)) return;
        add({ model: await loadModel(id) });
        add({ views: (await told(api.GET("/api/scans/{id}/views", { params }))).views });
        add({ cloud: await told(api.GET("/api/scans/{id}/cloud.ply", { params, parseAs: "arrayBuffer", ...LONG })) });
      } catch (error) {
        add({ failure: failureOf(error) });
      }
    })();
    return () => {
      wanted = false;
    };
  }, [id]);
  return loaded;
}
