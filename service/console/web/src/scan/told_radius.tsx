import type { Scan } from "../net/api";
import { addressOf } from "../route";
import { mm } from "../words/units";

/** Where no string was found that is as thick as somebody has told: what to try. */
export function ToldRadius({ scan }: { scan: Scan }) {
  if (scan.summary?.chains !== 0 || scan.string_radius_m === null) return null;
  return (
    <p class="note warn">
      <strong>Only a string of {mm(scan.string_radius_m)} in radius was looked for.</strong> If there may be another,{" "}
      <a href={addressOf("history", scan.id)}>work it out again</a> with the radius left empty, to be measured: nothing
      moves.
    </p>
  );
}
