import type { Model, Scan } from "../net/api";
import { when } from "../texts/format";
import { foundText, kindOf, resultOutcome, SHAPES } from "../texts/states";
import { t } from "../texts/translate";
import { SimulatedMark } from "../ui/simulated";
import { newerScan } from "./scan_notes";

/** The verdict on the whole result: whether a program may use it. */
export function Verdict({ scan, model }: { scan: Scan; model: Model }) {
  const { verdict, findings, views } = model.quality;
  const used = views.filter((view) => view.used).length;
  const strings = model.chains.length;
  const doubts = findings.filter(({ severity }) => severity !== "note").length;
  const partial = scan.state === "partial";
  const { word, tone } = resultOutcome({ verdict, strings, doubts, partial });
  return (
    <section class={`verdict ${tone}`} aria-label={t("result.verdict.region")}>
      <p class={`badge ${tone}`}>
        <span aria-hidden="true">{SHAPES[tone]}</span> {word}
      </p>{" "}
      <SimulatedMark scan={scan} /> {newerScan(scan) !== null && <strong class="warn">{t("result.verdict.earlier")}</strong>}
      <h1>{foundText(strings, model.crossings.length)}</h1>
      <p class="meaning">
        {meaningOf(model)} {used > 0 && t("result.verdict.views", { count: used })}{" "}
        {partial && missingText(scan)}
      </p>
      <p class="small">
        {t("scan.last.description", {
          kind: kindOf(scan),
          when: when(scan.created_at),
          method: t(`method.${scan.method}.name`),
        })}
      </p>
    </section>
  );
}

function meaningOf({ chains, quality: { verdict } }: Model): string {
  if (chains.length > 0 || verdict === "refuse") return t(`result.verdict.${verdict}`);
  return verdict === "review" ? t("result.verdict.no_string_review") : "";
}

/** Say which views a scan lacks, if that is known. */
function missingText({ progress }: Scan): string {
  const missing = progress.views.filter((view) => view.state === "missing").map((view) => view.index);
  if (missing.length === 0) return t("result.verdict.views_missing");
  return t("result.verdict.missing", { count: missing.length, indices: missing.join(", ") });
}
