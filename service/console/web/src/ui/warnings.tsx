import { sentence } from "../words/sentence";
import { counted } from "../words/units";

/** The first say most. */
const SHOWN = 3;

/** What a scan warns of; many of them are folded. */
export function Warnings({ warnings }: { warnings: readonly string[] }) {
  const more = warnings.slice(SHOWN);
  return (
    <>
      <Notes warnings={warnings.slice(0, SHOWN)} />
      {more.length > 0 && (
        <details>
          <summary>{counted(more.length, "more warning")}</summary>
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
