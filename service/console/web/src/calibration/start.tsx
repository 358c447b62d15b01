import { useState } from "preact/hooks";
import { api, slowly, told, type Run } from "../net/api";
import { calibration, cell } from "../state/cell";
import { askNow } from "../state/follow";
import { Act, Failed, useAction } from "../ui/action";
import { Field } from "../ui/field";
import { boardWords, KINDS, USUAL, type Kind } from "./board";

const NUMBERS = [
  ["columns", "Columns", String(USUAL.columns)],
  ["rows", "Rows", String(USUAL.rows)],
  ["pitch_mm", "Side of a square, or dot to dot, in mm", String(USUAL.pitch_m * 1000)],
  ["poses", "Poses", "15"],
] as const;

/** Begins a calibration or a verification: what to lay on the table, and which board that is. */
export function StartRun({ started }: { started: (run: Run) => void }) {
  const [kind, setKind] = useState<Kind | "">("");
  const [numbers, setNumbers] = useState<Partial<Record<(typeof NUMBERS)[number][0], string>>>({});
  const action = useAction();
  const fault = cell.value?.state === "fault";
  const number = (name: (typeof NUMBERS)[number][0]) => (numbers[name] ? Number(numbers[name]) : null);

  async function begin(run: Promise<Run>): Promise<void> {
    started(await run);
    askNow();
  }

  function calibrate(): Promise<Run> {
    const pitch_mm = number("pitch_mm");
    const board = {
      kind: kind === "" ? null : kind,
      columns: number("columns"),
      rows: number("rows"),
      pitch_m: pitch_mm === null ? null : pitch_mm / 1000,
    };
    return told(api.POST("/api/calibration/runs", { body: { board, poses: number("poses") ?? 15 }, ...slowly }));
  }

  return (
    <section class="panel" aria-label="Measure">
      <h2>First</h2>
      <ol>
        <li>
          Lay the board flat on the table, in the middle of the workspace, and see that it cannot slip. The usual board is{" "}
          {boardWords(USUAL)}.
        </li>
        <li>Take everything else off the table. The light is as in a scan, and no lamp is mirrored in the board.</li>
        <li>Nobody is within reach of the arm.</li>
      </ol>
      <div class="row">
        <Act
          action={action}
          work={() => begin(told(api.POST("/api/calibration/verify", slowly)))}
          doing="Preparing ..."
          disabled={fault || !calibration.value?.calibration}
        >
          Verify what is in use: the arm moves
        </Act>
        <span class="small">Two looks at the board that it was made with: does it still hold?</span>
      </div>
      <details>
        <summary>Another board than the usual one, or another number of poses</summary>
        <div class="row fields">
          <Field label="Kind of board">
            {(id) => (
              <select id={id} value={kind} onChange={(event) => setKind(event.currentTarget.value as Kind | "")}>
                <option value="">as the usual one: {KINDS[USUAL.kind]}</option>
                {Object.entries(KINDS).map(([value, words]) => (
                  <option key={value} value={value}>
                    {words}
                  </option>
                ))}
              </select>
            )}
          </Field>
          {NUMBERS.map(([name, label, empty]) => (
            <Field key={name} label={label}>
              {(id) => (
                <input
                  id={id}
                  type="number"
                  inputMode="decimal"
                  step="any"
                  min="0"
                  placeholder={empty}
                  value={numbers[name] ?? ""}
                  onInput={(event) => setNumbers({ ...numbers, [name]: event.currentTarget.value })}
                />
              )}
            </Field>
          ))}
        </div>
      </details>
      <Act action={action} kind="main" big work={() => begin(calibrate())} doing="Preparing ..." disabled={fault}>
        Calibrate: the arm moves
      </Act>
      <p class="small">The result is not in use before you say so.</p>
      <Failed failure={action.failure} />
    </section>
  );
}
