import type { Model } from "../net/api";
import { sentence } from "../texts/sentence";
import { t } from "../texts/translate";
import type { Target } from "../view3d/scene";
import { targetInMessage } from "./message_target";

/** The findings to read before anything is grasped. A press on a finding turns the view to it. */
export function Findings({ model, show }: { model: Model; show: (target: Target) => void }) {
  const { ambiguities, warnings, views } = model.quality;
  const messages = [...ambiguities, ...warnings];
  const unused = views.filter((view) => !view.used);
  const unobserved = model.chains.filter((chain) => chain.ends.includes("unseen"));
  const count = messages.length + unused.length + unobserved.length;
  if (count === 0) return <p class="note good">{t("result.findings.good")}</p>;
  return (
    <section aria-label={t("result.findings.region")}>
      <h2 class="warn">
        {model.chains.length === 0 ? t("result.findings.no_string") : t("result.findings.count", { count })}
      </h2>
      <ul class="targets">
        {messages.map((message) => (
          <li key={message}>
            <Finding message={message} show={show} />
          </li>
        ))}
        {unobserved.map(({ id, ends }) => (
          <li key={`string ${id}`}>
            <button type="button" onClick={() => show({ kind: "chain", id })}>
              {ends[0] === ends[1] ? t("result.findings.both_ends", { id }) : t("result.findings.one_end", { id })}
            </button>
          </li>
        ))}
        {unused.length < views.length &&
          unused.map(({ index, reason }) => (
            <li key={index}>
              <button type="button" onClick={() => show({ kind: "view", index })}>
                {sentence(
                  t("result.findings.view_unused", { index, reason: reason ?? t("common.no_reason") }),
                )}
              </button>
            </li>
          ))}
      </ul>
      {unused.length === views.length && <p>{t("result.findings.no_view", { count: views.length })}</p>}
    </section>
  );
}

function Finding({ message, show }: { message: string; show: (target: Target) => void }) {
  const target = targetInMessage(message);
  if (target === null) return <p class="note warn">{sentence(message)}</p>;
  return (
    <button type="button" onClick={() => show(target)}>
      {sentence(message)}
    </button>
  );
}
