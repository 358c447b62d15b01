import { useState } from "preact/hooks";
import { api, resultOf, type Scan } from "../net/api";
import { addressOf, replaceRoute } from "../route";
import { changes } from "../state/scans";
import { rich, t } from "../texts/translate";
import { Failed } from "../ui/action";
import { useQuery } from "../ui/use_query";

/** Number of results that are requested: several may recognise an earlier scan again. */
const LISTED = 20;

/** Opens the newest result as soon as there is one. The screen then keeps it, also when another scan ends. */
export function NewestResult() {
  const [none, setNone] = useState(false);
  const failure = useQuery(
    () => resultOf(api.GET("/api/scans", { params: { query: { state: ["succeeded", "partial"], limit: LISTED } } })),
    ({ scans }) => {
      const newest = newestOf(scans);
      if (newest !== undefined) replaceRoute("result", newest.id);
      setNone(newest === undefined);
    },
    [changes.value],
  );
  const link = (content: preact.ComponentChildren) => <a href={addressOf("scan")}>{content}</a>;

  return (
    <>
      <h1>{t("result.title")}</h1>
      {none ? <p>{rich("result.none", { link })}</p> : failure === null && <p>{t("result.loading")}</p>}
      <Failed failure={failure} />
    </>
  );
}

/**
 * Return the scan that shows the newest table, first of all its own result. One that was recognised again shows the
 * table at the time of its recording, whose ID rises with time.
 */
function newestOf(scans: readonly Scan[]): Scan | undefined {
  const key = ({ id, source, recording }: Scan) => (source === null ? id : (recording ?? ""));
  const again = ({ source }: Scan) => Number(source !== null);
  return [...scans].sort((a, b) => key(b).localeCompare(key(a)) || again(a) - again(b))[0];
}
