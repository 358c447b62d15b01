import type { Problem, ScanState } from "../net/api";
import { isSafetyStop, problemDetail, problemTitle, slugOf } from "../texts/problem";
import { rich } from "../texts/translate";
import { strong } from "./action";
import { WhatToDo } from "./manual";

/** Why a scan or run ended without a result. A requested stop is a warning, not an error. */
export function EndReason({ state, problem }: { state: ScanState; problem: Problem | null }) {
  if (problem === null) return null;
  const slug = slugOf(problem);
  const title = problemTitle(slug, problem.title);
  const detail = isSafetyStop(slug) ? "" : problemDetail(problem); // the acknowledgement may have been long ago
  return (
    <p class={`note ${state === "aborted" ? "warn" : "bad"}`}>
      {rich("failure.message", { title, detail, strong })}{" "}
      <WhatToDo problem={problem.type} />
    </p>
  );
}
