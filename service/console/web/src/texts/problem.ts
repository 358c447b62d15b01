import { findText } from "./translate";
import { sentence } from "./sentence";

const URN = "urn:pointchain:";

/** Return the slug of a problem type, such as `robot-lost`. */
export function slugOf(problem: { type: string } | string): string {
  return (typeof problem === "string" ? problem : problem.type).replace(URN, "");
}

/** Return the title of a problem: the catalogue's `problem.<slug>.title`, or else the service's text. */
export function problemTitle(slug: string | null, fallback: string): string {
  return (slug === null ? undefined : findText(`problem.${slug}.title`)) ?? fallback;
}

/** Return what to read about a problem: the catalogue's `problem.<slug>.advice`, if any, and the service's detail. */
export function problemDetail(slug: string | null, detail: string): string {
  const advice = slug === null ? undefined : findText(`problem.${slug}.advice`);
  return advice === undefined ? sentence(detail) : `${advice} ${sentence(detail)}`;
}
