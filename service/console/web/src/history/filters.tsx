import type { paths } from "../../generated/api";
import { Field } from "../ui/field";

/** What scans are asked for. */
export type Query = NonNullable<paths["/api/scans"]["get"]["parameters"]["query"]>;

/** What a person has chosen; empty: all. */
export interface Wanted {
  outcome: "" | "model" | "without" | "active";
  mode: "" | "live" | "replay";
  kept: boolean;
  /** Days, as 2026-01-31. */
  from: string;
  to: string;
}

export const ALL: Wanted = { outcome: "", mode: "", kept: false, from: "", to: "" };

const OUTCOMES: Record<Exclude<Wanted["outcome"], "">, Query["state"]> = {
  model: ["succeeded", "partial"],
  without: ["failed", "aborted", "interrupted"],
  active: ["queued", "preflight", "scanning", "processing", "stopping"],
};

/** The same as the service takes it; days are the browser's own. */
export function queryOf({ outcome, mode, kept, from, to }: Wanted): Query {
  return {
    ...(outcome === "" ? {} : { state: OUTCOMES[outcome] }),
    ...(mode === "" ? {} : { mode }),
    ...(kept ? { kept } : {}),
    ...(from === "" ? {} : { created_after: new Date(`${from}T00:00`).toISOString() }),
    ...(to === "" ? {} : { created_before: new Date(`${to}T23:59:59.999`).toISOString() }),
  };
}

interface FiltersProps {
  wanted: Wanted;
  want: (wanted: Wanted) => void;
}

/** Which scans are listed. */
export function Filters({ wanted, want }: FiltersProps) {
  const set = (part: Partial<Wanted>) => want({ ...wanted, ...part });
  return (
    <form class="row filters" onSubmit={(event) => event.preventDefault()}>
      <Field label="Outcome">
        {(id) => (
          <select
            id={id}
            value={wanted.outcome}
            onChange={(event) => set({ outcome: event.currentTarget.value as Wanted["outcome"] })}
          >
            <option value="">any</option>
            <option value="model">with a result</option>
            <option value="without">without a result</option>
            <option value="active">under way</option>
          </select>
        )}
      </Field>
      <Field label="Kind">
        {(id) => (
          <select id={id} value={wanted.mode} onChange={(event) => set({ mode: event.currentTarget.value as Wanted["mode"] })}>
            <option value="">any</option>
            <option value="live">by the cell</option>
            <option value="replay">from a recording</option>
          </select>
        )}
      </Field>
      <Field label="From">
        {(id) => <input id={id} type="date" value={wanted.from} onChange={(event) => set({ from: event.currentTarget.value })} />}
      </Field>
      <Field label="To">
        {(id) => <input id={id} type="date" value={wanted.to} onChange={(event) => set({ to: event.currentTarget.value })} />}
      </Field>
      <label class="tick">
        <input type="checkbox" checked={wanted.kept} onChange={(event) => set({ kept: event.currentTarget.checked })} />
        only those kept
      </label>
    </form>
  );
}
