import "./history.css";
import { useEffect, useState } from "preact/hooks";
import { api, told, type Scan } from "../net/api";
import { addressOf } from "../route";
import { changes, latest, show } from "../state/scans";
import { Act, Failed, failureOf, useAction, type Failure } from "../ui/action";
import { ALL, Filters, queryOf, type Wanted } from "./filters";
import { Row } from "./row";

const AT_A_TIME = 20;
/** The service lists no more at once. */
const MOST = 500;
/** After an answer that did not come. */
const AGAIN_MS = 5000;

interface Listed {
  scans: readonly Scan[];
  more: boolean;
}

async function scansOf(wanted: Wanted, limit: number, before?: string): Promise<Listed> {
  const query = { ...queryOf(wanted), limit, ...(before === undefined ? {} : { before }) };
  const { scans, next } = await told(api.GET("/api/scans", { params: { query } }));
  return { scans, more: next !== null };
}

/** Past scans: to look at again, to work out again, to keep, to take away. */
export function HistoryScreen() {
  const [wanted, want] = useState(ALL);
  const [listed, setListed] = useState<Listed | null>(null);
  const [failure, setFailure] = useState<Failure | null>(null);
  const [tries, setTries] = useState(0);
  const older = useAction();

  useEffect(() => {
    let current = true;
    let timer: ReturnType<typeof setTimeout> | undefined;
    // As many as are shown already, so that older ones stay.
    const limit = Math.min(Math.max(listed?.scans.length ?? 0, AT_A_TIME), MOST);
    scansOf(wanted, limit).then(
      (found) => {
        if (!current) return;
        setListed(found);
        setFailure(null);
      },
      (error: unknown) => {
        if (!current) return;
        timer = setTimeout(() => setTries((before) => before + 1), AGAIN_MS);
        setFailure(failureOf(error));
      },
    );
    return () => {
      current = false;
      clearTimeout(timer);
    };
  }, [wanted, changes.value, tries]);

  function choose(other: Wanted): void {
    setListed(null); // what is shown is never of another choice
    want(other);
  }

  async function showOlder(): Promise<void> {
    if (listed === null) return;
    const found = await scansOf(wanted, AT_A_TIME, listed.scans.at(-1)?.id);
    // Not behind a list that has come in meanwhile.
    setListed((now) => (now === listed ? { scans: [...listed.scans, ...found.scans], more: found.more } : now));
  }

  function changed(one: Scan): void {
    setListed((now) => now && { ...now, scans: now.scans.map((two) => (two.id === one.id ? one : two)) });
    if (latest.value?.id === one.id) show(one);
  }

  // The one under way is told more of, and sooner.
  const shown = listed?.scans.map((scan) => (scan.id === latest.value?.id ? latest.value : scan));
  return (
    <div class="history">
      <h1>History</h1>
      <Filters wanted={wanted} want={choose} />
      <Failed failure={failure} />
      {shown?.length === 0 && (
        <p>
          {Object.keys(queryOf(wanted)).length === 0 ? "There is no scan yet" : "There is no such scan: choose less above"}. <a href={addressOf("scan")}>Scan</a>
        </p>
      )}
      <ul class="scans" aria-label="Scans, the newest first">
        {shown?.map((scan) => (
          <Row key={scan.id} scan={scan} changed={changed} />
        ))}
      </ul>
      {listed?.more && (
        <Act action={older} work={showOlder} doing="Asking ...">
          Show older ones
        </Act>
      )}
      <Failed failure={older.failure} />
    </div>
  );
}
