import { useState } from "preact/hooks";
import { api, slowly, told, type Run } from "../net/api";
import { calibration, cell } from "../state/cell";
import { askNow } from "../state/follow";
import { Act, Failed, useAction } from "../ui/action";
import { Field } from "../ui/field";
import { Hint } from "../ui/hint";
import { NumberField } from "../ui/number_field";
import { readNumber, type Limits } from "../words/number";
import { boardWords, KINDS, USUAL, type Kind } from "./board";

type Name = "columns" | "rows" | "pitch_mm" | "poses";

/** What can be told in numbers: its label, what it is unless told, and what it may be. */
const NUMBERS: Record<Name, [string, number, Limits]> = {
  columns: ["Columns", USUAL.columns, { min: 3, max: 100, whole: true }],
  rows: ["Rows", USUAL.rows, { min: 3, max: 100, whole: true }],
  pitch_mm: ["Side of a square, or dot to dot, in mm", USUAL.pitch_m * 1000, { min: 1, max: 500, unit: "mm" }],
  poses: ["Poses", 15, { min: 10, max: 40, whole: true }],
};
const NAMES = Object.keys(NUMBERS) as Name[];

/** Begins a calibration or a verification: what to lay on the table, and which board that is. */
export function StartRun({ started }: { started: (run: Run) => void }) {
  const [kind, setKind] = useState<Kind | "">("");
  const [written, write] = useState<Record<Name, string>>({ columns: "", rows: "", pitch_mm: "", poses: "" });
  const action = useAction();
  const fault = cell.value?.state === "fault";
  const reading = (name: Name) => readNumber(written[name], NUMBERS[name][2]);
  const faulty = NAMES.some((name) => reading(name).fault !== null);
  const used = calibration.value?.calibration;

  async function begin(run: Promise<Run>): Promise<void> {
    started(await run);
    askNow();
  }

  function calibrate(): Promise<Run> {
    const pitch_mm = reading("pitch_mm").value;
    const board = {
      kind: kind === "" ? null : kind,
      columns: reading("columns").value,
      rows: reading("rows").value,
      pitch_m: pitch_mm === null ? null : pitch_mm / 1000,
    };
    return told(api.POST("/api/calibration/runs", { body: { board, poses: reading("poses").value ?? NUMBERS.poses[1] }, ...slowly }));
  }

  return (
    <section class="panel" aria-label="Measure">
      <h2>First</h2>
      <ol>
        <li>
          Lay the board flat on the table, in the middle of the workspace, and see that it cannot slip.{" "}
          <Hint term="board">{`The usual one is ${boardWords(USUAL) ?? ""}`}</Hint>
        </li>
        <li>Take everything else off the table. The light is as in a scan, and no lamp is mirrored in the board.</li>
        <li>Nobody is within reach of the arm.</li>
      </ol>
      <div class="row">
        <Act
          action={action}
          work={() => begin(told(api.POST("/api/calibration/verify", slowly)))}
          doing="Preparing ..."
          disabled={fault || boardWords(used?.board ?? null) === null}
        >
          Verify what is in use: the arm moves
        </Act>
        <span class="small">
          {used && boardWords(used.board) === null
            ? "What is in use does not tell of its board, so it cannot be verified: calibrate."
            : "Two looks at the board that it was made with: does it still hold?"}
        </span>
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
          {NAMES.map((name) => (
            <NumberField
              key={name}
              label={NUMBERS[name][0]}
              reading={reading(name)}
              write={(text) => write({ ...written, [name]: text })}
              empty={String(NUMBERS[name][1])}
            />
          ))}
        </div>
      </details>
      <Act action={action} kind="main" big work={() => begin(calibrate())} doing="Preparing ..." disabled={fault || faulty}>
        Calibrate: the arm moves
      </Act>
      <p class="small">The result is not in use before you say so.</p>
      <Failed failure={action.failure} />
    </section>
  );
}
