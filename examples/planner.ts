// Scan, decide alone whether to grasp, to scan again or to ask a person, and print the grasp. Uses fetch alone.
//
// Run: node examples/planner.ts [URL]   (Node 24 runs TypeScript directly). The service's arm moves.
// A token comes from POINTCHAIN_TOKEN, if set.

import { randomUUID } from "node:crypto";

type Problem = { type: string; title: string; detail: string };
type Scan = {
  id: string;
  state: string;
  final: boolean;
  problem: Problem | null;
  links: { self: string; model: string | null };
};
type Grasp = { chain: number; s_m: number; opening_m: number; T_base_grasp: number[][] };
type Finding = { code: string; severity: "note" | "doubt" | "blocking"; message: string };
type Verdict = "accept" | "review" | "refuse";
type Model = {
  chains: { id: number; trust: Verdict }[];
  grasps: Grasp[];
  quality: { verdict: Verdict; findings: Finding[] };
};

const service = process.argv[2] ?? "http://127.0.0.1:8000";
const token = process.env["POINTCHAIN_TOKEN"];
const MORE_DATA_HELPS = new Set([
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
  const answer = await fetch(new URL(path, service), { method, headers, body: body && JSON.stringify(body) });
  if (!answer.ok) {
    const problem = (await answer.json()) as Problem;
    throw new Error(`${problem.type}: ${problem.detail}`);
  }
  return (await answer.json()) as T;
}

async function scan(): Promise<Model> {
  const wanted = { mode: "live", string_radius_m: 0.0042 };
  let scan = await call<Scan>("POST", "/api/scans", wanted, randomUUID());
  while (!scan.final) {
    await new Promise((resolve) => setTimeout(resolve, 500));
    scan = await call<Scan>("GET", scan.links.self);
  }
  if (scan.links.model === null) {
    throw new Error(`scan ${scan.id} is ${scan.state}: ${scan.problem?.detail}`);
  }
  return call<Model>("GET", scan.links.model);
}

/** Return a grasp to carry out, or what to do instead. */
function decide({ chains, grasps, quality }: Model, mayRescan: boolean): Grasp | "done" | "rescan" | "ask" {
  if (quality.verdict === "accept" && chains.length === 0) return "done";
  const accepted = new Set(chains.filter(({ trust }) => trust === "accept").map(({ id }) => id));
  const grasp = grasps.find(({ chain }) => accepted.has(chain));
  if (grasp !== undefined) return grasp;
  const doubts = quality.findings.filter(({ severity }) => severity !== "note");
  const moreDataHelps = doubts.length > 0 && doubts.every(({ code }) => MORE_DATA_HELPS.has(code));
  return mayRescan && moreDataHelps ? "rescan" : "ask";
}

async function main(): Promise<number> {
  let model = await scan();
  let decision = decide(model, true);
  if (decision === "rescan") {
    model = await scan();
    decision = decide(model, false);
  }
  if (typeof decision === "string") {
    const messages = model.quality.findings.map(({ message }) => message);
    console.error([`${decision}:`, ...messages].join("\n  "));
    return decision === "done" ? 0 : 1;
  }
  await call("POST", "/api/cell/release"); // returns when the arm is home: from here on this program may move it
  console.log(`chain ${decision.chain} at ${decision.s_m} m, open to ${decision.opening_m} m, T_base_grasp:`);
  console.log(JSON.stringify(decision.T_base_grasp));
  return 0;
}

try {
  process.exitCode = await main();
} catch (error) {
  console.error(`planner: ${error instanceof Error ? error.message : error}`);
  process.exitCode = 1;
}
