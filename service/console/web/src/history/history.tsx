import { useState } from "preact/hooks";
import { api, resultOf, type Scan } from "../net/api";
import { changes, latest, show } from "../state/scans";
import { t } from "../texts/translate";
import { Failed } from "../ui/action";
import { useQuery } from "../ui/use_query";
import { ALL, Filters, queryOf, type Filter } from "./filters";
import { Row } from "./row";

const PAGE_SIZE = 20;
/** Limit of the service. */
const MAX_LISTED = 500;

interface Listed {
  filter: Filter;
  scans: readonly Scan[];
  more: boolean;
}

async function scansOf(filter: Filter, limit: number): Promise<Listed> {
  const query = { ...queryOf(filter), limit };
  const { scans, next } = await resultOf(api.GET("/api/scans", { params: { query } }));
  return { filter, scans, more: next !== null };
}

/** Past scans: show, recognise again, protect, download. */
export function HistoryScreen({ id }: { id: string | null }) {
  const [filter, setFilter] = useState(ALL);
  const [listed, setListed] = useState<Listed | null>(null);
  const [linked, setLinked] = useState<Scan | null>(null);
  const [limit, setLimit] = useState(PAGE_SIZE);

  const failure = useQuery(() => scansOf(filter, limit), setListed, [filter, limit, changes.value]);

  const unlinked = useQuery(
    async () => (id === null ? null : resultOf(api.GET("/api/scans/{id}", { params: { path: { id } } }))),
    setLinked,
    [id],
  );

  function changed(one: Scan): void {
    setListed((now) => now && { ...now, scans: now.scans.map((two) => (two.id === one.id ? one : two)) });
    if (linked?.id === one.id) setLinked(one);
    if (latest.value?.id === one.id) show(one);
  }

  // The earlier list is shown until the answer comes, but not if the request fails.
  const current = failure === null || listed?.filter === filter ? listed : null;
  // The running scan is known better from its events.
  const shown = current?.scans.map((scan) => (scan.id === latest.value?.id ? latest.value : scan));
  const filtered = Object.keys(queryOf(filter)).length > 0;
  // A linked scan that is too old for the list comes first.
  if (linked !== null && !filtered && shown?.every((scan) => scan.id !== linked.id)) shown.unshift(linked);
  return (
    <div class="history">
      <h1>{t("history.title")}</h1>
      <Filters filter={filter} setFilter={setFilter} />
      <Failed failure={failure ?? unlinked} />
      {shown?.length === 0 && <p>{filtered ? t("history.none_match") : t("history.none")}</p>}
      <ul class="scans" aria-label={t("history.list")}>
        {shown?.map((scan) => (
          <Row key={scan.id} scan={scan} opened={scan.id === id} changed={changed} />
        ))}
      </ul>
      {current?.more &&
        (limit < MAX_LISTED ? (
          <button
            type="button"
            disabled={current.scans.length < limit}
            onClick={() => setLimit(Math.min(limit + PAGE_SIZE, MAX_LISTED))}
          >
            {current.scans.length < limit ? t("common.loading") : t("history.older")}
          </button>
        ) : (
          <p>{t("history.limit")}</p>
        ))}
    </div>
  );
}
