import type { Scan } from "../net/api";
import { sentence } from "../texts/sentence";
import { isActive } from "../texts/states";
import { t } from "../texts/translate";
import { Picture } from "../ui/picture";

type View = Scan["progress"]["views"][number];

interface ViewsProps {
  scan: Scan;
  /** Indices of the viewpoints that the arm has not reached yet. */
  planned?: readonly number[];
}

/** The views of a live scan, with the height image of each recorded one. */
export function Views({ scan, planned = [] }: ViewsProps) {
  const { views } = scan.progress;
  const indices = [...views.map((view) => view.index), ...planned].sort((a, b) => a - b);
  const missing = views.filter((view) => view.state === "missing" && view.reason !== null);
  return (
    <section class="scan-views" aria-label={t("scan.views.region")}>
      <ol class="views" aria-label={t("common.views")}>
        {indices.map((index) => (
          <Card key={index} scan={scan} index={index} view={views.find((one) => one.index === index)} />
        ))}
      </ol>
      {missing.map(({ index, reason }) => (
        <p key={index} class="note warn">
          {sentence(t("scan.views.missing", { index, reason: reason ?? t("common.no_reason") }))}
        </p>
      ))}
    </section>
  );
}

interface CardProps {
  scan: Scan;
  index: number;
  /** Undefined: the arm has not reached it yet. */
  view: View | undefined;
}

function Card({ scan, index, view }: CardProps) {
  const state = view?.state ?? (isActive(scan.state) ? "planned" : "not_recorded");
  return (
    <li class={state} value={index}>
      {state === "recorded" ? (
        <Picture src={`/api/scans/${scan.id}/views/${index}.png`} alt={t("scan.views.alt", { index })} />
      ) : (
        <span class="picture">{state === "moving" ? "..." : state === "missing" ? "✗" : ""}</span>
      )}
      {t("scan.views.label", { index, state: t(`view_state.${state}`) })}
    </li>
  );
}
