import { useState } from "preact/hooks";
import { api, told } from "../net/api";
import { addressOf, settle } from "../route";
import { changes } from "../state/scans";
import { Failed } from "../ui/action";
import { useAsked } from "../ui/asked";

/** So many of the newest results are asked for: some of them may only work out an earlier scan again. */
const SOME = 20;

/** Goes to the newest result, as soon as there is one; from then on it is that one, also when another scan ends. */
export function NewestResult() {
  const [none, setNone] = useState(false);
  const failure = useAsked(
    () => told(api.GET("/api/scans", { params: { query: { state: ["succeeded", "partial"], limit: SOME } } })),
    ({ scans }) => {
      const newest = scans.find((scan) => scan.source === null) ?? scans[0];
      if (newest !== undefined) settle("result", newest.id);
      setNone(newest === undefined);
    },
    [changes.value],
  );

  return (
    <>
      <h1>Result</h1>
      {none ? (
        <p>
          No scan has a result yet. <a href={addressOf("scan")}>Scan</a> first.
        </p>
      ) : (
        failure === null && <p>Asking for the newest result ...</p>
      )}
      <Failed failure={failure} />
    </>
  );
}
