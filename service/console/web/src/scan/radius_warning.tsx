import type { Scan } from "../net/api";
import { addressOf } from "../route";
import { mm } from "../texts/format";
import { rich } from "../texts/translate";
import { strong } from "../ui/action";

/** Advice after a scan with a given radius found no string. */
export function RadiusWarning({ scan }: { scan: Scan }) {
  if (scan.summary?.chains !== 0 || scan.string_radius_m === null) return null;
  const link = (content: preact.ComponentChildren) => <a href={addressOf("history", scan.id)}>{content}</a>;
  return <p class="note warn">{rich("scan.radius.only", { radius: mm(scan.string_radius_m), strong, link })}</p>;
}
