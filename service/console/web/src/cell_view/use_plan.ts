import { useState } from "preact/hooks";
import { api, resultOf, type Plan, type Scan } from "../net/api";
import { useQuery } from "../ui/use_query";

/** Load the plan of a live scan as soon as it has one; null before, and for a replay. */
export function useScanPlan(scan: Scan | null): Plan | null {
  const [loaded, setLoaded] = useState<{ id: string; plan: Plan } | null>(null);
  const hasPlan = scan?.mode === "live" && ["preflight", "scanning", "processing"].includes(scan.state);
  const id = hasPlan ? scan.id : null;
  useQuery(
    async () => (id === null ? null : resultOf(api.GET("/api/scans/{id}/plan", { params: { path: { id } } }))),
    (plan) => {
      if (id !== null && plan !== null) setLoaded({ id, plan });
    },
    [id],
  );
  return loaded?.id === scan?.id ? (loaded?.plan ?? null) : null;
}
