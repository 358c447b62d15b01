import type { ComponentChildren } from "preact";
import type { Finding, Model } from "../net/api";
import { distinctFindings, FINDING_TONES, findingText } from "../texts/findings";
import { sentence } from "../texts/sentence";
import { t } from "../texts/translate";
import { Original } from "../ui/original";
import type { Target, ViewPose } from "../view3d/scene";
import { findingTarget } from "./finding_target";

interface FindingsProps {
  model: Model;
  views: readonly ViewPose[];
  /** Turns the view to a target. */
  show: (target: Target) => void;
}

/** The findings. A press on one turns the view to its position. */
export function Findings({ model, views, show }: FindingsProps) {
  const findings = distinctFindings(model.quality.findings);
  const noString = model.chains.length === 0;
  const items = (listed: readonly Finding[]) => (
    <ul class="targets">
      {listed.map((finding) => (
        <li key={finding.message}>
          <Item finding={finding} target={findingTarget(finding, model, views)} show={show} />
        </li>
      ))}
    </ul>
  );
  return (
    <section aria-label={t("result.findings.region")}>
      {noString ? (
        <>
          {findings.length > 0 && <h2 class="warn">{t("result.findings.no_string")}</h2>}
          {items(findings)}
        </>
      ) : (
        <BySeverity findings={findings} items={items} />
      )}
    </section>
  );
}

interface BySeverityProps {
  findings: readonly Finding[];
  items: (listed: readonly Finding[]) => ComponentChildren;
}

/** The blocking findings, then the doubts, then the notes, which are collapsed. */
function BySeverity({ findings, items }: BySeverityProps) {
  const [blocking, doubts, notes] = (["blocking", "doubt", "note"] as const).map((severity) =>
    findings.filter((finding) => finding.severity === severity),
  ) as [Finding[], Finding[], Finding[]];
  return (
    <>
      {blocking.length > 0 && (
        <>
          <h2 class="bad">{t("result.findings.blocking", { count: blocking.length })}</h2>
          {items(blocking)}
        </>
      )}
      {doubts.length > 0 && (
        <>
          <h2 class="warn">{t("result.findings.doubts", { count: doubts.length })}</h2>
          {items(doubts)}
        </>
      )}
      {notes.length > 0 && (
        <details>
          <summary>{t("result.findings.notes", { count: notes.length })}</summary>
          {items(notes)}
        </details>
      )}
    </>
  );
}

interface ItemProps {
  finding: Finding;
  target: Target | null;
  show: (target: Target) => void;
}

/** A finding: a button if it has a position. */
function Item({ finding, target, show }: ItemProps) {
  const { severity, message } = finding;
  const text = findingText(finding);
  const content = (
    <>
      {text} <Original shown={text} text={sentence(message)} />
    </>
  );
  if (target === null) return <p class={`note ${FINDING_TONES[severity]}`}>{content}</p>;
  return (
    <button type="button" class={severity === "note" ? "" : severity} onClick={() => show(target)}>
      {content}
    </button>
  );
}
