import type { Scan } from "../net/api";
import { Picture } from "../ui/picture";
import { sentence } from "../ui/action";

const WORDS = { moving: "on the way", recorded: "taken", missing: "missing" } as const;

/** Each viewpoint of a live scan, with what the camera measured there as it comes in; `coming`: so many are to come. */
export function Views({ scan, coming = 0 }: { scan: Scan; coming?: number }) {
  const reasons = scan.progress.views.filter((view) => view.state === "missing" && view.reason !== null);
  return (
    <>
      <ol class="views" aria-label="Views">
        {scan.progress.views.map((view) => (
          <li key={view.index} class={view.state} value={view.index + 1}>
            {view.state === "recorded" ? (
              <Picture
                src={`/api/scans/${scan.id}/views/${view.index}.png`}
                alt={`Height above the table, seen from viewpoint ${view.index + 1}`}
              />
            ) : (
              <span class="picture">{view.state === "moving" ? "..." : "✗"}</span>
            )}
            {view.index + 1} {WORDS[view.state]}
          </li>
        ))}
        {Array.from({ length: coming }, (_, k) => (
          <li key={`coming ${k}`}>
            <span class="picture" />
            to come
          </li>
        ))}
      </ol>
      {reasons.map((view) => (
        <p key={view.index} class="note warn">
          View {view.index + 1} is missing: {sentence(view.reason ?? "")}
        </p>
      ))}
    </>
  );
}
