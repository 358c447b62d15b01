import type { Problem } from "../net/api";
import { sentence } from "./sentence";
import { fillText, findText } from "./translate";

const URN = "urn:pointchain:";

/** Return the slug of a problem type, such as `robot-lost`. */
export function slugOf(problem: { type: string } | string): string {
  return (typeof problem === "string" ? problem : problem.type).replace(URN, "");
}

/** Return whether the robot's safety system made the problem. Its details only say what to do before the acknowledgement. */
export function isSafetyStop(slug: string | null): boolean {
  return slug === "protective-stop" || slug === "emergency-stop";
}

/** Return the title of a problem: the catalogue's `problem.<slug>.title`, or else the service's text. */
export function problemTitle(slug: string | null, fallback: string): string {
  return (slug === null ? undefined : findText(`problem.${slug}.title`)) ?? fallback;
}

/**
 * Return what to read about a problem: the catalogue's `problem.<slug>.advice`, if any, and the detail. The detail is the
 * catalogue's `problem.<slug>.detail` if the problem has all its placeholders as parameters, or else the service's text.
 */
export function problemDetail(problem: Problem): string {
  const slug = slugOf(problem);
  const advice = findText(`problem.${slug}.advice`);
  const detail = fillText(`problem.${slug}.detail`, readable(problem.parameters ?? {})) ?? sentence(problem.detail);
  return advice === undefined ? detail : `${advice} ${detail}`;
}

/** Return parameters with the names of roles and states as a person reads them. */
function readable(parameters: NonNullable<Problem["parameters"]>): Record<string, string | number> {
  return Object.fromEntries(
    Object.entries(parameters).map(([name, value]) => [
      name,
      findText(`app.role_name.${value}`) ?? findText(`scan_state.${value}`) ?? value,
    ]),
  );
}
