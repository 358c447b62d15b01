import type { ComponentChildren } from "preact";
import type { Screen } from "../route";
import { slugOf } from "../net/api";

const MANUAL = "/manual";

/** The section of the manual that describes a screen. */
export const SECTIONS: Record<Screen | "sign-in", string> = {
  scan: "operator/console.html#scan",
  result: "operator/console.html#result",
  history: "operator/console.html#history",
  calibration: "operator/console.html#calibration",
  "sign-in": "operator/console.html#sign-in",
};

interface ManualLinkProps {
  /** Page below the manual's address, with its section. */
  page: string;
  /** The accessible name, which begins with the text that is shown. */
  name: string;
  children: ComponentChildren;
}

/** A link to a page of the manual. It opens in another tab, so that STOP stays in view in this one. */
export function ManualLink({ page, name, children }: ManualLinkProps) {
  return (
    <a href={`${MANUAL}/${page}`} target="_blank" rel="noopener" aria-label={`${name} (opens in a new tab)`}>
      {children}
    </a>
  );
}

const SERVICE_PROBLEM = /^urn:pointchain:[a-z0-9-]+$/;

/** A link to the section on a problem type; nothing for problems that the service did not name. */
export function WhatToDo({ problem }: { problem: string | null }) {
  if (problem === null || !SERVICE_PROBLEM.test(problem)) return null;
  const slug = slugOf(problem);
  return (
    <ManualLink page={`planner/errors.html#${slug}`} name={`What to do: ${slug.replaceAll("-", " ")}`}>
      What to do
    </ManualLink>
  );
}
