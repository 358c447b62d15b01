import { useEffect, useState } from "preact/hooks";
import { api, resultOf, type Model, type Scan } from "../../net/api";
import { request } from "../../net/request";
import type { Failure } from "../../ui/action";
import { useQuery } from "../../ui/use_query";
import { changes } from "../../state/scans";
import { hasModel, isActive } from "../../texts/states";
import type { ViewPose } from "../../view3d/scene";

/** A large cloud takes long over a slow network. */
const LONG = { fetch: (call: Request) => request(call, 120) };

/** The results of a scan; those not loaded yet are null or empty. */
interface Loaded {
  scan: Scan | null;
  model: Model | null;
  cloud: ArrayBuffer | null;
  views: readonly ViewPose[];
}

const NOTHING: Loaded = { scan: null, model: null, cloud: null, views: [] };

/** Load the model of a scan. */
export async function loadModel(id: string): Promise<Model> {
  const document: unknown = await resultOf(api.GET("/api/scans/{id}/model", { params: { path: { id } }, ...LONG }));
  return document as Model; // the client types points as lists of any length
}

/** Load the results of a scan one after the other, the model first. Those of a scan that runs are loaded at its end. */
export function useResult(id: string): Loaded & { failure: Failure | null } {
  const [loaded, setLoaded] = useState(NOTHING);
  const add = (part: Partial<Loaded>) => setLoaded((before) => ({ ...before, ...part }));
  const params = { path: { id } };

  async function load(): Promise<void> {
    const scan = await resultOf(api.GET("/api/scans/{id}", { params: { ...params } }));
    add({ scan });
    if (!hasModel(scan)) return;
    add({ model: await loadModel(id) });
    add({ views: (await resultOf(api.GET("/api/scans/{id}/views", { params }))).views });
    add({ cloud: await resultOf(api.GET("/api/scans/{id}/cloud.ply", { params, parseAs: "arrayBuffer", ...LONG })) });
  }

  const [lastChange, setLastChange] = useState(changes.value); // the last one after which the scan was requested
  const runs = loaded.scan !== null && isActive(loaded.scan.state);
  useEffect(() => {
    if (runs) setLastChange(changes.value);
  }, [runs, changes.value]);
  const failure = useQuery(load, () => undefined, [id, lastChange]);
  return { ...loaded, failure };
}
