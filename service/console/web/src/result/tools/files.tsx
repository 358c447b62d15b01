import type { Model, Scan } from "../../net/api";
import { when } from "../../texts/format";
import { kindOf, outcome } from "../../texts/states";
import { t } from "../../texts/translate";
import { ResultFiles } from "../../ui/result_files";
import type { View3D } from "../../view3d/view3d";
import type { Caption } from "../../view3d/picture";
import { centreLines } from "./centre_lines";
import { save } from "./save";

interface FilesProps {
  scan: Scan;
  model: Model;
  /** The 3D view; null: it is not open, or the browser has none. */
  view: View3D | null;
}

/** Saves the result as files: those of the service, and those that the page makes. */
export function Files({ scan, model, view }: FilesProps) {
  return (
    <section aria-label={t("files.title")}>
      <h2>{t("files.title")}</h2>
      <div class="row">
        <ResultFiles scan={scan} except={view === null ? [] : ["preview"]} />
        {model.chains.length > 0 && (
          <button
            type="button"
            onClick={() => save(nameOf(scan, "-centre-lines.csv"), new Blob([centreLines(model)], { type: "text/csv" }))}
          >
            {t("files.centre_lines")}
          </button>
        )}
        {view !== null && (
          <button type="button" onClick={async () => save(nameOf(scan, ".png"), await view.picture(captionOf(scan)))}>
            {t("files.view3d")}
          </button>
        )}
      </div>
    </section>
  );
}

/** Return the name of a file that the page makes. It says whether the cell is simulated. */
function nameOf(scan: Scan, ending: string): string {
  return `${scan.id}${scan.simulated === true ? "-simulated" : ""}${ending}`;
}

/** Return what a saved picture shows. */
function captionOf(scan: Scan): Caption {
  const named = t("common.kind_and_time", { kind: kindOf(scan), when: when(scan.created_at) });
  return { mark: scan.simulated === true ? t("simulated.both") : null, lines: [`${outcome(scan).word}, ${named}`, scan.id] };
}
