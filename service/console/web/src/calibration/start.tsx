import { useState } from "preact/hooks";
import { api, longCall, resultOf, type Run } from "../net/api";
import { calibration, cell } from "../state/cell";
import { refreshNow } from "../state/updates";
import { rich, shown, t } from "../texts/translate";
import { Act, Failed, useAction } from "../ui/action";
import { Field } from "../ui/field";
import { Hint } from "../ui/hint";
import { NumberField } from "../ui/number_field";
import { parseNumber, type Limits } from "../ui/parse_number";
import { boardText, DEFAULT_BOARD, type Kind, KINDS } from "./board";

/** Unit of the pitch. */
const MM = 1000;

type Name = "columns" | "rows" | "pitch_mm" | "poses";

/** The numbers that can be entered: default and limits. */
const NUMBERS: Record<Name, [number, Limits]> = {
  columns: [DEFAULT_BOARD.columns, { min: 3, max: 100, whole: true }],
  rows: [DEFAULT_BOARD.rows, { min: 3, max: 100, whole: true }],
  pitch_mm: [DEFAULT_BOARD.pitch_m * MM, { min: 1, max: 500 }],
  poses: [15, { min: 10, max: 40, whole: true }],
};
const NAMES = Object.keys(NUMBERS) as Name[];

/** Starts a calibration or a verification: how to prepare the table, and which board is used. */
export function StartRun({ started }: { started: (run: Run) => void }) {
  const [kind, setKind] = useState<Kind | "">("");
  const [entered, setEntered] = useState<Record<Name, string>>({ columns: "", rows: "", pitch_mm: "", poses: "" });
  const action = useAction();
  const fault = cell.value?.state === "fault";
  const numberOf = (name: Name) => {
    const limits = NUMBERS[name][1];
    return parseNumber(entered[name], name === "pitch_mm" ? { ...limits, unit: t("units.millimetres") } : limits);
  };
  const invalid = NAMES.some((name) => numberOf(name).fault !== null);
  const used = calibration.value?.calibration;
  const usedBoard = boardText(used?.board ?? null);
  const defaultBoard = t("calibration.start.default_board", { board: boardText(DEFAULT_BOARD) ?? "" });

  async function start(run: Promise<Run>): Promise<void> {
    started(await run);
    refreshNow();
  }

  function calibrate(): Promise<Run> {
    const pitch_mm = numberOf("pitch_mm").value;
    const board = {
      kind: kind === "" ? null : kind,
      columns: numberOf("columns").value,
      rows: numberOf("rows").value,
      pitch_m: pitch_mm === null ? null : pitch_mm / MM,
    };
    const body = { board, poses: numberOf("poses").value ?? NUMBERS.poses[0] };
    return resultOf(api.POST("/api/calibration/runs", { body, ...longCall }));
  }

  return (
    <section class="panel" aria-label={t("calibration.start.region")}>
      <h2>{t("calibration.start.title")}</h2>
      <ol>
        <li>{rich("calibration.start.lay_board", { default: <Hint term="board">{defaultBoard}</Hint> })}</li>
        <li>{t("calibration.start.clear_table")}</li>
        <li>{t("calibration.start.reach")}</li>
      </ol>
      <div class="row">
        <Act
          action={action}
          work={() => start(resultOf(api.POST("/api/calibration/verify", longCall)))}
          doing={t("calibration.start.preparing")}
          disabled={fault || usedBoard === null}
        >
          {t("calibration.start.verify")}
        </Act>
        <span class="small">
          {used && usedBoard === null
            ? t("calibration.start.verify_unknown_board")
            : t("calibration.start.verify_hint")}
        </span>
      </div>
      <details>
        <summary>{t("calibration.start.options")}</summary>
        <div class="row fields">
          <Field label={t("calibration.start.kind")}>
            {(id) => (
              <select id={id} value={kind} onChange={(event) => setKind(event.currentTarget.value as Kind | "")}>
                <option value="">
                  {t("calibration.start.kind_default", { kind: t(`calibration.board.kind_long.${DEFAULT_BOARD.kind}`) })}
                </option>
                {KINDS.map((value) => (
                  <option key={value} value={value}>
                    {t(`calibration.board.kind_long.${value}`)}
                  </option>
                ))}
              </select>
            )}
          </Field>
          {NAMES.map((name) => (
            <NumberField
              key={name}
              label={t(`calibration.start.${name}`)}
              number={numberOf(name)}
              write={(text) => setEntered({ ...entered, [name]: text })}
              empty={shown(NUMBERS[name][0])}
            />
          ))}
        </div>
      </details>
      <Act
        action={action}
        kind="main"
        big
        work={() => start(calibrate())}
        doing={t("calibration.start.preparing")}
        disabled={fault || invalid}
      >
        {t("calibration.start.calibrate")}
      </Act>
      <p class="small">{t("calibration.start.calibrate_hint")}</p>
      <Failed failure={action.failure} />
    </section>
  );
}
