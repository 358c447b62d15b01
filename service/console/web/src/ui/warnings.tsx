import { sentence } from "../texts/sentence";
import { t } from "../texts/translate";

/** The service lists the most important warnings first. */
const SHOWN = 3;

/** The warnings of a scan; further ones are collapsed. */
export function Warnings({ warnings }: { warnings: readonly string[] }) {
  const more = warnings.slice(SHOWN);
  return (
    <>
      <Notes warnings={warnings.slice(0, SHOWN)} />
      {more.length > 0 && (
        <details>
          <summary>{t("warnings.more", { count: more.length })}</summary>
          <Notes warnings={more} />
        </details>
      )}
    </>
  );
}

function Notes({ warnings }: { warnings: readonly string[] }) {
  return (
    <>
      {warnings.map((warning) => (
        <p key={warning} class="note warn">
          {sentence(warning)}
        </p>
      ))}
    </>
  );
}
