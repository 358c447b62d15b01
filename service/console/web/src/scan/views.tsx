import type { Scan } from "../net/api";
import { Picture } from "../ui/picture";
import { sentence } from "../words/sentence";

const WORDS = { moving: "on the way", recorded: "taken", missing: "missing" } as const;

interface ViewsProps {
  scan: Scan;
  /** Numbers of viewpoints that the arm has not come to yet. */
  coming?: readonly number[];
}

/** Each viewpoint of a live scan, with what the camera measured there as it comes in. */
export function Views({ scan, coming = [] }: ViewsProps) {
  const met = scan.progress.views;
  const all = [...met.map((view) => view.index), ...coming].sort((a, b) => a - b);
  const reasons = scan.progress.views.filter((view) => view.state === "missing" && view.reason !== null);
  return (
    <>
      <ol class="views" aria-label="Views">
        {all.map((index) => (
          <Card key={index} scan={scan} index={index} view={met.find((one) => one.index === index)} />
        ))}
      </ol>
      {reasons.map((view) => (
        <p key={view.index} class="note warn">
          {sentence(`View ${view.index} is missing: ${view.reason ?? ""}`)}
        </p>
      ))}
    </>
  );
}

interface CardProps {
  scan: Scan;
  index: number;
  /** Undefined: the arm has not come to it yet. */
  view: Scan["progress"]["views"][number] | undefined;
}

function Card({ scan, index, view }: CardProps) {
  const words = view === undefined ? "to come" : WORDS[view.state];
  return (
    <li class={view?.state ?? ""} value={index}>
      {view?.state === "recorded" ? (
        <Picture
          src={`/api/scans/${scan.id}/views/${index}.png`}
          alt={`Height above the table, seen from viewpoint ${index}`}
        />
      ) : (
        <span class="picture">{view?.state === "moving" ? "..." : view?.state === "missing" ? "✗" : ""}</span>
      )}
      {index} {words}
    </li>
  );
}
