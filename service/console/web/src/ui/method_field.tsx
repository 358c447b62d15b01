import type { Method } from "../net/api";
import { METHODS } from "../texts/states";
import { t } from "../texts/translate";
import { Field } from "./field";

/** The choice of the recognition method. */
export function MethodField({ method, choose }: { method: Method; choose: (method: Method) => void }) {
  return (
    <Field label={t("field.method")} hint="method">
      {(id) => (
        <select id={id} value={method} onChange={(event) => choose(event.currentTarget.value as Method)}>
          {METHODS.map((value) => (
            <option key={value} value={value}>
              {t(`method.${value}.name`)}
            </option>
          ))}
        </select>
      )}
    </Field>
  );
}
