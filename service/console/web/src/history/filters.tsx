import type { paths } from "../../generated/api";
import { t } from "../texts/translate";
import { Field } from "../ui/field";

/** The query parameters of the scan list. */
export type Query = NonNullable<paths["/api/scans"]["get"]["parameters"]["query"]>;

/** The chosen filters; empty: all scans. */
export interface Filter {
  outcome: "" | "model" | "without" | "active";
  mode: "" | "live" | "replay";
  kept: boolean;
  /** Days, as 2026-01-31. */
  from: string;
  to: string;
}

export const ALL: Filter = { outcome: "", mode: "", kept: false, from: "", to: "" };

const OUTCOMES: Record<Exclude<Filter["outcome"], "">, Query["state"]> = {
  model: ["succeeded", "partial"],
  without: ["failed", "aborted", "interrupted"],
  active: ["queued", "connecting", "preflight", "scanning", "processing", "stopping"],
};

/** Return the filters as query parameters; days are in the time zone of the browser. */
export function queryOf({ outcome, mode, kept, from, to }: Filter): Query {
  return {
    ...(outcome === "" ? {} : { state: OUTCOMES[outcome] }),
    ...(mode === "" ? {} : { mode }),
    ...(kept ? { kept } : {}),
    ...(from === "" ? {} : { created_after: new Date(`${from}T00:00`).toISOString() }),
    ...(to === "" ? {} : { created_before: new Date(`${to}T23:59:59.999`).toISOString() }),
  };
}

interface FiltersProps {
  filter: Filter;
  setFilter: (filter: Filter) => void;
}

/** The filters of the list. */
export function Filters({ filter, setFilter }: FiltersProps) {
  const set = (part: Partial<Filter>) => setFilter({ ...filter, ...part });
  return (
    <form class="row filters" onSubmit={(event) => event.preventDefault()}>
      <Field label={t("history.filter.outcome")}>
        {(id) => (
          <select
            id={id}
            value={filter.outcome}
            onChange={(event) => set({ outcome: event.currentTarget.value as Filter["outcome"] })}
          >
            <option value="">{t("history.filter.any")}</option>
            <option value="model">{t("history.filter.model")}</option>
            <option value="without">{t("history.filter.without")}</option>
            <option value="active">{t("history.filter.active")}</option>
          </select>
        )}
      </Field>
      <Field label={t("history.filter.kind")}>
        {(id) => (
          <select id={id} value={filter.mode} onChange={(event) => set({ mode: event.currentTarget.value as Filter["mode"] })}>
            <option value="">{t("history.filter.any")}</option>
            <option value="live">{t("history.filter.live")}</option>
            <option value="replay">{t("history.filter.replay")}</option>
          </select>
        )}
      </Field>
      <Field label={t("history.filter.from")}>
        {(id) => <input id={id} type="date" value={filter.from} onChange={(event) => set({ from: event.currentTarget.value })} />}
      </Field>
      <Field label={t("history.filter.to")}>
        {(id) => <input id={id} type="date" value={filter.to} onChange={(event) => set({ to: event.currentTarget.value })} />}
      </Field>
      <label class="tick">
        <input type="checkbox" checked={filter.kept} onChange={(event) => set({ kept: event.currentTarget.checked })} />
        {t("history.filter.kept")}
      </label>
    </form>
  );
}
