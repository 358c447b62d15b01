import type { Method } from "../net/api";
import { METHODS } from "../words/states";
import { Field } from "./field";

/** Asks for the method of recognition. */
export function MethodField({ method, choose }: { method: Method; choose: (method: Method) => void }) {
  return (
    <Field label="Method" hint="method">
      {(id) => (
        <select id={id} value={method} onChange={(event) => choose(event.currentTarget.value as Method)}>
          {Object.entries(METHODS).map(([value, { name }]) => (
            <option key={value} value={value}>
              {name}
            </option>
          ))}
        </select>
      )}
    </Field>
  );
}
