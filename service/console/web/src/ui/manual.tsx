import type { ComponentChildren } from "preact";
import type { Screen } from "../route";
import { slugOf } from "../texts/problem";
import { findText, t } from "../texts/translate";

const MANUAL = "/manual";

/** The section of the manual that describes a screen. */
export const SECTIONS: Record<Screen | "sign-in", string> = {
  scan: "operator/console.html#scan",
  result: "operator/results.html#results",
  history: "operator/console.html#history",
  calibration: "operator/console.html#calibration",
  "sign-in": "operator/console.html#sign-in",
};

interface ManualLinkProps {
  /** Page below the manual's address, with its section. */
  page: string;
  /** The accessible name, which begins with the visible text. */
  name: string;
  children: ComponentChildren;
}

/** A link to a page of the manual. It opens in another tab, so that STOP stays visible in this one. */
export function ManualLink({ page, name, children }: ManualLinkProps) {
  return (
    <a href={`${MANUAL}/${page}`} target="_blank" rel="noopener" aria-label={t("help.new_tab", { name })}>
      {children}
    </a>
  );
}

const SERVICE_PROBLEM = /^urn:pointchain:[a-z0-9-]+$/;

/** The operator's section about each problem type that a person resolves at the cell. */
export const FAULTS: Record<string, string> = {
  "not-connected": "not-connected",
  "released": "not-connected",
  "stopped": "what-stop-does",
  "aborted": "what-stop-does",
  "acknowledge-required": "first",
  "protective-stop": "protective-stop",
  "too-early": "protective-stop",
  "emergency-stop": "emergency-stop",
  "robot-lost": "robot-lost",
  "motion-failed": "motion-failed",
  "robot-not-ready": "robot-not-ready",
  "robot-unreachable": "robot-not-ready",
  "camera-lost": "camera-lost-or-not-found",
  "camera-unreachable": "camera-lost-or-not-found",
  "bad-frame": "bad-images-or-too-few-views",
  "no-depth": "bad-images-or-too-few-views",
  "insufficient-views": "bad-images-or-too-few-views",
  "contradicting-views": "bad-images-or-too-few-views",
  "depth-noise": "bad-images-or-too-few-views",
  "calibration": "calibration-missing-old-or-drifted",
  "calibration-refused": "calibration-missing-old-or-drifted",
  "viewpoints-unreachable": "viewpoints-out-of-reach",
  "radius-unknown": "string-not-found-or-not-recognised",
  "table-elsewhere": "table-not-where-it-is-configured",
  "too-crowded": "string-not-found-or-not-recognised",
  "recognition-timeout": "string-not-found-or-not-recognised",
  "storage-full": "disk-full",
  "interrupted": "the-service-does-not-answer",
};

/** A link to the section about a problem type; nothing if the service named none. */
export function WhatToDo({ problem }: { problem: string | null }) {
  if (problem === null || !SERVICE_PROBLEM.test(problem)) return null;
  const slug = slugOf(problem);
  const fault = FAULTS[slug];
  const page = fault === undefined ? `planner/errors.html#${slug}` : `operator/faults.html#${fault}`;
  return (
    <ManualLink page={page} name={t("help.what_to_do_about", { problem: findText(`problem.${slug}.title`) ?? slug.replaceAll("-", " ") })}>
      {t("help.what_to_do")}
    </ManualLink>
  );
}
