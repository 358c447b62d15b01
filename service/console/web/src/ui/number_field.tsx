import type { Reading } from "../words/number";
import { Field } from "./field";
import type { Term } from "./hint";

interface NumberFieldProps {
  label: string;
  hint?: Term;
  reading: Reading;
  write: (text: string) => void;
  /** What it is when nothing is written. */
  empty: string;
}

/** An input for a number, which says at once what is wrong with what is written. */
export function NumberField({ label, hint, reading, write, empty }: NumberFieldProps) {
  return (
    <Field label={label} hint={hint}>
      {(id) => (
        <>
          <input
            id={id}
            class="number"
            inputMode="decimal"
            autocomplete="off"
            value={reading.text}
            placeholder={empty}
            aria-invalid={reading.fault !== null}
            aria-describedby={`${id}-fault`}
            onInput={(event) => write(event.currentTarget.value)}
          />
          <span id={`${id}-fault`} class="fault-text" role="status">
            {reading.fault}
          </span>
        </>
      )}
    </Field>
  );
}
