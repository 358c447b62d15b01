import type { ComponentChildren } from "preact";
import { useState } from "preact/hooks";
import { RefusedError } from "../net/api";
import { CancelledError, NoAnswerError } from "../net/request";
import { lost } from "../state/freshness";
import { problemDetail, problemTitle } from "../texts/problem";
import { rich, t } from "../texts/translate";
import { WhatToDo } from "./manual";

/** Why an action failed, for people. */
export interface Failure {
  title: string;
  detail: string;
  slug: string;
  /** The service's problem type; null: the service named none. */
  problem: string | null;
  retryAfter_s: number | null;
}

/** Describe an error for people; throw it again if it is unexpected. */
export function failureOf(error: unknown): Failure {
  if (error instanceof RefusedError) {
    const { slug, problem, retryAfter_s } = error;
    const title = problemTitle(slug, problem.title);
    return { title, detail: problemDetail(problem), slug, problem: problem.type, retryAfter_s };
  }
  if (error instanceof NoAnswerError) {
    const { timeout_s } = error;
    const detail =
      timeout_s === null ? t("failure.lost.network") : t("failure.lost.timeout", { seconds: timeout_s });
    return { title: t("failure.lost.title"), detail, slug: "lost", problem: null, retryAfter_s: null };
  }
  if (error instanceof CancelledError) {
    const [title, detail] = [t("failure.cancelled.title"), t("failure.cancelled.detail")];
    return { title, detail, slug: "cancelled", problem: null, retryAfter_s: null };
  }
  throw error;
}

/** An action of a button: one at a time. Its failure is kept until the next attempt. */
export interface Action {
  busy: boolean;
  failure: Failure | null;
  run(work: () => Promise<void>): Promise<void>;
}

/** Return an action that belongs to a component. */
export function useAction(): Action {
  const [busy, setBusy] = useState(false);
  const [failure, setFailure] = useState<Failure | null>(null);
  return {
    busy,
    failure,
    async run(work) {
      setBusy(true);
      setFailure(null);
      try {
        await work();
      } catch (error) {
        setFailure(failureOf(error));
      } finally {
        setBusy(false);
      }
    },
  };
}

interface ActProps {
  action: Action;
  work: () => Promise<void>;
  children: ComponentChildren;
  /** The button's text while the action runs. */
  doing?: string;
  kind?: "main" | "plain";
  big?: boolean;
  disabled?: boolean;
}

/** A button that sends a request. It is disabled while a request runs and while the page is out of date. */
export function Act({ action, work, children, doing, kind = "plain", big = false, disabled = false }: ActProps) {
  return (
    <button
      type="button"
      class={big ? `${kind} big` : kind}
      disabled={disabled || action.busy || lost.value}
      onClick={() => void action.run(work)}
    >
      {action.busy && doing !== undefined ? doing : children}
    </button>
  );
}

/** The failure of an action, if it failed. */
export function Failed({ failure }: { failure: Failure | null }) {
  return (
    <div role="alert">
      {failure && (
        <p class="note bad">
          {rich("failure.message", { title: failure.title, detail: failure.detail, strong })}{" "}
          <WhatToDo problem={failure.problem} />
        </p>
      )}
    </div>
  );
}

/** Draw the tag `<strong>` of a text. */
export function strong(content: ComponentChildren): ComponentChildren {
  return <strong>{content}</strong>;
}
