import type { Finding, Model } from "../../net/api";
import type { Chain, Crossing } from "../../view3d/scene";
import { completeGrasps, type EarlierGrasp } from "./earlier_grasps";

/** The members of a type that have a name. */
type Named<T> = { [K in keyof T as string extends K ? never : number extends K ? never : K]: T[K] };
type Topology = Named<Model["topology"]>;
type Element = Topology["p_data"]["elements"][number];

/** A model of schema `pointchain/1`, as an earlier release stored it. */
export interface Schema1Model extends Omit<Named<Model>, "schema" | "chains" | "crossings" | "grasps" | "quality"> {
  schema: "pointchain/1";
  chains: (Omit<Named<Chain>, "ends" | "trust" | "trusted_m"> & { ends: [Schema1End, Schema1End] })[];
  crossings: Omit<Named<Crossing>, "trust">[];
  /** Missing in the oldest models. */
  grasps?: Omit<Named<EarlierGrasp>, "trusted">[];
  quality: {
    ambiguities: string[];
    warnings: string[];
    views: Omit<Named<Model["quality"]["views"][number]>, "code">[];
  };
}

type Schema1End = "free" | "unseen";

/**
 * Return a model of schema `pointchain/1` in the form of `pointchain/2`. Each message becomes a doubt about all chains.
 * No chain is trusted, because fewer checks were made.
 */
export function fromSchema1(document: Schema1Model): Model {
  const { ambiguities, warnings, views } = document.quality;
  const messages = [...ambiguities, ...warnings];
  const chains = document.chains.map(({ id }) => id);
  const findings = messages.map(
    (message): Finding => ({ code: "pointchain-1", severity: "doubt", message, chains }),
  );
  const { topology } = document;
  const elements = topology.p_data.elements.map(
    (element) => ("end" in element ? { ...element, end: endOf(element.end as Schema1End) } : element) as Element,
  );
  return {
    ...document,
    schema: "pointchain/2",
    chains: document.chains.map((chain) => ({
      ...chain,
      ends: [endOf(chain.ends[0]), endOf(chain.ends[1])],
      trust: "review",
      trusted_m: [],
    })),
    crossings: document.crossings.map((crossing) => ({ ...crossing, trust: "review" })),
    topology: { ...topology, p_data: { ...topology.p_data, elements } },
    grasps: completeGrasps((document.grasps ?? []).map((grasp) => ({ ...grasp, trusted: false }))),
    quality: { verdict: "review", findings, views: views.map((view) => ({ ...view, code: null })) },
  };
}

function endOf(end: Schema1End): Chain["ends"][number] {
  return end === "unseen" ? "unobserved" : end;
}
