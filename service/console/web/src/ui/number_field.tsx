import { Field } from "./field";
import type { Term } from "./hint";
import type { ParsedNumber } from "./parse_number";

interface NumberFieldProps {
  label: string;
  hint?: Term;
  number: ParsedNumber;
  write: (text: string) => void;
  /** Placeholder: the value that applies if the field is empty. */
  empty: string;
}

/** An input for a number, which shows at once what is wrong with it. */
export function NumberField({ label, hint, number, write, empty }: NumberFieldProps) {
  return (
    <Field label={label} hint={hint}>
      {(id) => (
        <>
          <input
            id={id}
            class="number"
            inputMode="decimal"
            autocomplete="off"
            value={number.text}
            placeholder={empty}
            aria-invalid={number.fault !== null}
            aria-describedby={`${id}-fault`}
            onInput={(event) => write(event.currentTarget.value)}
          />
          <span id={`${id}-fault`} class="fault-text" role="status">
            {number.fault}
          </span>
        </>
      )}
    </Field>
  );
}
