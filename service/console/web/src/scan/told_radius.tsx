import type { Scan } from "../net/api";
import { mm } from "../words/units";

/** Where no string was found that is as thick as somebody has told: what to try. */
export function ToldRadius({ scan }: { scan: Scan }) {
  if (scan.summary?.chains !== 0 || scan.string_radius_m === null) return null;
  return (
    <p class="note warn">
      <strong>Only a string of {mm(scan.string_radius_m)} in radius was looked for, as told.</strong> If there is another on
      the table, leave the radius to be measured.
    </p>
  );
}
