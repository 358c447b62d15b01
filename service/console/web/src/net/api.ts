import createClient from "openapi-fetch";
import type { components, paths } from "../../generated/api";
import { OURS } from "./ours";
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
export type Room = components["schemas"]["RoomResource"];
export type Plan = components["schemas"]["PlanDocument"];
export type Method = Scan["method"];

/** The service's calls, typed by its description. */
export const api = createClient<paths>({ fetch: (asked) => request(asked), headers: OURS });

/** For calls that take long, as those that wait for a robot. */
export const slowly = { fetch: (asked: Request) => request(asked, 120) };

/** The service refused what was asked for. */
export class RefusedError extends Error {
  constructor(
    readonly problem: Problem,
    /** When it is worth to ask again; null: the service does not tell. */
    readonly retryAfter_s: number | null,
  ) {
    super(problem.detail);
  }

  get slug(): string {
    return slugOf(this.problem);
  }
}

/** What a problem is, in one word. */
export function slugOf(problem: { type: string } | string): string {
  return (typeof problem === "string" ? problem : problem.type).replace("urn:pointchain:", "");
}

interface Answer<T> {
  data?: T;
  error?: unknown;
  response: Response;
}

/**
 * What was answered.
 *
 * @throws RefusedError, LostError, GivenUpError
 */
export async function told<T>(asked: Promise<Answer<T>>): Promise<NonNullable<T>> {
  const { data, error, response } = await asked;
  if (data !== undefined && data !== null) return data;
  const retry = Number(response.headers.get("Retry-After") ?? NaN);
  throw new RefusedError(asProblem(error, response), Number.isFinite(retry) ? retry : null);
}

function asProblem(error: unknown, response: Response): Problem {
  if (typeof error === "object" && error !== null && "type" in error && "detail" in error) return error as Problem;
  const title = `The answer was ${response.status}`;
  return { type: "about:blank", title, status: response.status, detail: `${title}, without a reason.` };
}
