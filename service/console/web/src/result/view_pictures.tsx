import { useEffect, useRef, useState } from "preact/hooks";
import type { Model } from "../net/api";
import { degrees, mm, percent } from "../texts/format";
import { sentence } from "../texts/sentence";
import { SHAPES } from "../texts/states";
import { t } from "../texts/translate";
import { Picture } from "../ui/picture";
import type { Target, ViewPose } from "../view3d/scene";
import type { Selection } from "../viewer/viewer";
import { revealBeside } from "./reveal";

type Quality = Model["quality"]["views"][number];

interface ViewPicturesProps {
  model: Model;
  views: readonly ViewPose[];
  selection: Selection | null;
  /** Selects a target, and turns the view to it. */
  show: (target: Target) => void;
}

/** The depth images of the views, collapsed. A press on one shows its camera in the 3D view, and its quality. */
export function ViewPictures({ model, views, selection, show }: ViewPicturesProps) {
  const selected = selection?.target.kind === "view" ? selection.target.index : null;
  const [open, setOpen] = useState(false);
  useEffect(() => {
    if (selected !== null) setOpen(true);
  }, [selected]);
  if (views.length === 0) return null;
  const qualityOf = (index: number) => model.quality.views.find((one) => one.index === index);
  return (
    <details class="view-pictures" open={open} onToggle={(event) => setOpen(event.currentTarget.open)}>
      <summary>{t("result.views.title", { count: views.length })}</summary>
      {open && (
        <>
          <p class="small">{t("result.views.legend")}</p>
          <ul>
            {views.map(({ index, image }) => (
              <li key={index} class={index === selected ? "selected-view" : ""}>
                <button type="button" aria-pressed={index === selected} onClick={() => show({ kind: "view", index })}>
                  <Picture src={image} alt="" />
                  <ViewName index={index} used={qualityOf(index)?.used ?? true} />
                </button>
                {index === selected && (
                  <ViewQuality index={index} quality={qualityOf(index)} picked={selection?.turn === false} />
                )}
              </li>
            ))}
          </ul>
        </>
      )}
    </details>
  );
}

function ViewName({ index, used }: { index: number; used: boolean }) {
  const name = t("result.views.name", { index });
  if (used) return <span>{name}</span>;
  return (
    <span>
      <span aria-hidden="true">{SHAPES.warn}</span> {t("result.views.unused_name", { name })}
    </span>
  );
}

interface ViewQualityProps {
  index: number;
  quality: Quality | undefined;
  /** It was selected in the 3D view, so the page may have to scroll to it. */
  picked: boolean;
}

/** How recognition used a view. */
function ViewQuality({ index, quality, picked }: ViewQualityProps) {
  const section = useRef<HTMLElement>(null);
  useEffect(() => {
    if (picked && section.current !== null) revealBeside(section.current);
  }, [picked]);
  return (
    <section ref={section} class="panel point" aria-label={t("result.views.region")}>
      <h2>{t("result.views.name", { index })}</h2>
      {quality === undefined ? <p>{t("result.views.unknown")}</p> : <QualityList quality={quality} />}
    </section>
  );
}

function QualityList({ quality: { used, reason, points, fitness, rms_m, correction_m, correction_rad } }: { quality: Quality }) {
  return (
    <dl>
      <dt>{t("result.views.used")}</dt>
      <dd>{used ? t("result.views.yes") : t("result.views.no", { reason: sentence(reason ?? "") })}</dd>
      <dt>{t("result.views.points")}</dt>
      <dd>{points}</dd>
      {fitness !== null && (
        <>
          <dt>{t("result.views.fitness")}</dt>
          <dd>{percent(fitness)}</dd>
        </>
      )}
      {rms_m !== null && (
        <>
          <dt>{t("result.views.rms")}</dt>
          <dd>{mm(rms_m, 2)}</dd>
        </>
      )}
      {correction_m !== null && correction_rad !== null && (
        <>
          <dt>{t("result.views.correction")}</dt>
          <dd>{t("result.views.correction_text", { distance: mm(correction_m, 2), angle: degrees(correction_rad, 2) })}</dd>
        </>
      )}
    </dl>
  );
}
