import createClient from "openapi-fetch";
import type { components, paths } from "../../generated/api";
import { CONSOLE_HEADERS } from "./headers";
import { slugOf } from "../texts/problem";
import { t } from "../texts/translate";
import { request } from "./request";

export type Cell = components["schemas"]["CellResource"];
export type Scan = components["schemas"]["ScanResource"];
export type ScanState = Scan["state"];
export type Caller = components["schemas"]["CallerResource"];
export type Calibration = components["schemas"]["CalibrationStatus"];
export type Run = components["schemas"]["RunResource"];
export type Recording = components["schemas"]["RecordingResource"];
export type Model = components["schemas"]["ModelDocument"];
export type Problem = components["schemas"]["Problem"];
export type CellGeometry = components["schemas"]["CellGeometry"];
export type Plan = components["schemas"]["PlanDocument"];
export type Method = Scan["method"];
export type Verdict = Model["quality"]["verdict"];
/** Without joint angles, which the client types as lists of any length. */
export type GraspReach = Pick<components["schemas"]["ReachDocument"], "reachable" | "path_free" | "reason" | "message">;
export type Finding = components["schemas"]["FindingDocument"];

/** The service's calls, typed by its description. */
export const api = createClient<paths>({ fetch: (call) => request(call), headers: CONSOLE_HEADERS });

/** Options of calls that take long, such as those that wait for the robot. */
export const longCall = { fetch: (call: Request) => request(call, 120) };

/** The service refused a request. */
export class RefusedError extends Error {
  constructor(
    readonly problem: Problem,
    /** Seconds until the request can succeed; null: the service names none. */
    readonly retryAfter_s: number | null,
  ) {
    super(problem.detail);
  }

  get slug(): string {
    return slugOf(this.problem);
  }
}

interface Answer<T> {
  data?: T;
  error?: unknown;
  response: Response;
}

/**
 * Return the body of an answer.
 *
 * @throws RefusedError, NoAnswerError, CancelledError
 */
export async function resultOf<T>(call: Promise<Answer<T>>): Promise<NonNullable<T>> {
  const { data, error, response } = await call;
  if (data !== undefined && data !== null) return data;
  const retry = Number(response.headers.get("Retry-After") ?? NaN);
  throw new RefusedError(asProblem(error, response), Number.isFinite(retry) ? retry : null);
}

function asProblem(error: unknown, response: Response): Problem {
  if (typeof error === "object" && error !== null && "type" in error && "detail" in error) return error as Problem;
  const { status } = response;
  const [title, detail] = [t("failure.no_problem.title", { status }), t("failure.no_problem.detail", { status })];
  return { type: "about:blank", title, status, detail } as unknown as Problem; // no type of the service
}
