// Scan, decide whether to trust the model, take over the arm, and print the best grasp. Uses fetch alone.
//
// Run: node examples/planner.ts [URL]   (Node 24 runs TypeScript directly). The service's arm moves.
// A token comes from POINTCHAIN_TOKEN, if set.

import { randomUUID } from "node:crypto";

type Problem = { type: string; title: string; detail: string };
type Scan = {
  id: string;
  state: string;
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
const ACTIVE = ["queued", "preflight", "scanning", "processing", "stopping"];

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

async function main(): Promise<number> {
  const wanted = { mode: "live", string_radius_m: 0.0042 };
  let scan = await call<Scan>("POST", "/api/scans", wanted, randomUUID());
  while (ACTIVE.includes(scan.state)) {
    await new Promise((resolve) => setTimeout(resolve, 500));
    scan = await call<Scan>("GET", scan.links.self);
  }
  if (scan.links.model === null) {
    throw new Error(`scan ${scan.id} is ${scan.state}: ${scan.problem?.detail}`);
  }
  const model = await call<Model>("GET", scan.links.model);
  const accepted = new Set(model.chains.filter((chain) => chain.trust === "accept").map((chain) => chain.id));
  const grasp = model.grasps.find(({ chain }) => accepted.has(chain));
  if (grasp === undefined) {
    const messages = model.quality.findings.map(({ code, message }) => `${message} [${code}]`);
    console.error([`verdict ${model.quality.verdict}, no automatic grasp:`, ...messages].join("\n  "));
    return 1;
  }
  await call("POST", "/api/cell/release"); // returns when the arm is home: from here on this program may move it
  console.log(`chain ${grasp.chain} at ${grasp.s_m} m, open to ${grasp.opening_m} m, T_base_grasp:`);
  console.log(JSON.stringify(grasp.T_base_grasp));
  return 0;
}

try {
  process.exitCode = await main();
} catch (error) {
  console.error(`planner: ${error instanceof Error ? error.message : error}`);
  process.exitCode = 1;
}
