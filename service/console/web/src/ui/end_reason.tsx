import type { Problem, ScanState } from "../net/api";
import { problemDetail, problemTitle, slugOf } from "../texts/problem";
import { rich } from "../texts/translate";
import { strong } from "./action";
import { WhatToDo } from "./manual";

/** Why a scan or run ended without a result. A requested stop is a warning, not an error. */
export function EndReason({ state, problem }: { state: ScanState; problem: Problem | null }) {
  if (problem === null) return null;
  const slug = slugOf(problem);
  const title = problemTitle(slug, problem.title);
  return (
    <p class={`note ${state === "aborted" ? "warn" : "bad"}`}>
      {rich("failure.message", { title, detail: problemDetail(problem), strong })}{" "}
      <WhatToDo problem={problem.type} />
    </p>
  );
}
