import type { Problem, ScanState } from "../net/api";
import { sentence } from "../words/sentence";
import { WhatToDo } from "./manual";

/** Why something ended without a result; that somebody wanted it to end is no fault. */
export function WhyEnded({ state, problem }: { state: ScanState; problem: Problem | null }) {
  if (problem === null) return null;
  return (
    <p class={`note ${state === "aborted" ? "warn" : "bad"}`}>
      <strong>{problem.title}.</strong> Told then: {sentence(problem.detail)} <WhatToDo problem={problem.type} />
    </p>
  );
}
