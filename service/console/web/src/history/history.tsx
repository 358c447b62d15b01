import "./history.css";
import { useState } from "preact/hooks";
import { api, told, type Scan } from "../net/api";
import { changes, latest, show } from "../state/scans";
import { Failed } from "../ui/action";
import { useAsked } from "../ui/asked";
import { ALL, Filters, queryOf, type Wanted } from "./filters";
import { Row } from "./row";

const AT_A_TIME = 20;
/** The service lists no more at once. */
const MOST = 500;

interface Listed {
  of: Wanted;
  scans: readonly Scan[];
  more: boolean;
}

async function scansOf(wanted: Wanted, limit: number): Promise<Listed> {
  const query = { ...queryOf(wanted), limit };
  const { scans, next } = await told(api.GET("/api/scans", { params: { query } }));
  return { of: wanted, scans, more: next !== null };
}

/** Past scans: to look at again, to work out again, to keep, to take away. */
export function HistoryScreen({ id }: { id: string | null }) {
  const [wanted, want] = useState(ALL);
  const [listed, setListed] = useState<Listed | null>(null);
  const [linked, setLinked] = useState<Scan | null>(null);
  const [limit, setLimit] = useState(AT_A_TIME);

  const failure = useAsked(() => scansOf(wanted, limit), setListed, [wanted, limit, changes.value]);

  const unlinked = useAsked(
    async () => (id === null ? null : told(api.GET("/api/scans/{id}", { params: { path: { id } } }))),
    setLinked,
    [id],
  );

  function changed(one: Scan): void {
    setListed((now) => now && { ...now, scans: now.scans.map((two) => (two.id === one.id ? one : two)) });
    if (linked?.id === one.id) setLinked(one);
    if (latest.value?.id === one.id) show(one);
  }

  // What was chosen before is shown until the answer comes, but not when there is none.
  const current = failure === null || listed?.of === wanted ? listed : null;
  // The one under way is told more of, and sooner.
  const shown = current?.scans.map((scan) => (scan.id === latest.value?.id ? latest.value : scan));
  const filtered = Object.keys(queryOf(wanted)).length > 0;
  // One that somebody wants to see comes first where it is too old for the list.
  if (linked !== null && !filtered && shown?.every((scan) => scan.id !== linked.id)) shown.unshift(linked);
  return (
    <div class="history">
      <h1>History</h1>
      <Filters wanted={wanted} want={want} />
      <Failed failure={failure ?? unlinked} />
      {shown?.length === 0 && (
        <p>
          {filtered ? "No scan is like that: change what is chosen above." : "There is no scan yet."}
        </p>
      )}
      <ul class="scans" aria-label="Scans, the newest first">
        {shown?.map((scan) => (
          <Row key={scan.id} scan={scan} opened={scan.id === id} changed={changed} />
        ))}
      </ul>
      {current?.more &&
        (limit < MOST ? (
          <button
            type="button"
            disabled={current.scans.length < limit}
            onClick={() => setLimit(Math.min(limit + AT_A_TIME, MOST))}
          >
            {current.scans.length < limit ? "Asking ..." : "Show older ones"}
          </button>
        ) : (
          <p>Older ones are listed when the days are chosen above.</p>
        ))}
    </div>
  );
}
