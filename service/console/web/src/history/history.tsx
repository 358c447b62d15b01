import "./history.css";
import { useEffect, useState } from "preact/hooks";
import { api, told, type Scan } from "../net/api";
import { addressOf } from "../route";
import { changes, latest } from "../state/scans";
import { Act, Failed, failureOf, useAction, type Failure } from "../ui/action";
import { ALL, Filters, queryOf, type Wanted } from "./filters";
import { Row } from "./row";

const AT_A_TIME = 20;

async function scansOf(wanted: Wanted, before?: string): Promise<{ scans: Scan[]; more: boolean }> {
  const query = { ...queryOf(wanted), limit: AT_A_TIME, ...(before === undefined ? {} : { before }) };
  const { scans, next } = await told(api.GET("/api/scans", { params: { query } }));
  return { scans, more: next !== null };
}

/** Past scans: to look at again, to work out again, to keep, to take away. */
export function HistoryScreen() {
  const [wanted, want] = useState(ALL);
  const [listed, setListed] = useState<{ scans: Scan[]; more: boolean } | null>(null);
  const [failure, setFailure] = useState<Failure | null>(null);
  const older = useAction();

  useEffect(() => {
    let current = true;
    scansOf(wanted).then(
      (found) => {
        if (!current) return;
        setListed(found);
        setFailure(null);
      },
      (error: unknown) => current && setFailure(failureOf(error)),
    );
    return () => {
      current = false;
    };
  }, [wanted, changes.value]);

  async function showOlder(): Promise<void> {
    const scans = listed?.scans ?? [];
    const found = await scansOf(wanted, scans.at(-1)?.id);
    setListed({ scans: [...scans, ...found.scans], more: found.more });
  }

  // The one under way is told more of, and sooner.
  const shown = listed?.scans.map((scan) => (scan.id === latest.value?.id ? latest.value : scan));
  return (
    <div class="history">
      <h1>History</h1>
      <Filters wanted={wanted} want={want} />
      <Failed failure={failure} />
      {shown?.length === 0 && (
        <p>
          {wanted === ALL ? "There is no scan yet" : "There is no such scan"}. <a href={addressOf("scan")}>Scan</a>
        </p>
      )}
      <ul class="scans" aria-label="Scans, the newest first">
        {shown?.map((scan) => (
          <Row
            key={scan.id}
            scan={scan}
            changed={(one) =>
              setListed((before) => before && { ...before, scans: before.scans.map((two) => (two.id === one.id ? one : two)) })
            }
          />
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
