import { useEffect, useRef, useState } from "preact/hooks";
import { t } from "../../texts/translate";

/** Copies a value as JSON: lengths in metres, angles in radians. */
export function Copy({ value }: { value: object }) {
  const [state, setState] = useState<"copied" | "by_hand" | null>(null);
  const field = useRef<HTMLTextAreaElement>(null);
  const text = JSON.stringify(value, null, 1);
  useEffect(() => setState(null), [text]);
  useEffect(() => {
    if (state === "by_hand") field.current?.select();
  }, [state]);
  return (
    <>
      <button type="button" onClick={async () => setState((await copied(text)) ? "copied" : "by_hand")}>
        {t("result.copy.button")}
      </button>
      <span role="status" class="good copied">
        {state === "copied" && t("result.copy.copied")}
      </span>
      {state === "by_hand" && (
        <label class="by-hand">
          {t("result.copy.by_hand")}
          <textarea ref={field} readOnly rows={5} value={text} onFocus={(event) => event.currentTarget.select()} />
        </label>
      )}
    </>
  );
}

/** Copy a text to the clipboard; return whether this worked. */
async function copied(text: string): Promise<boolean> {
  // Only pages of HTTPS and of this machine have a clipboard, and a browser may not allow it.
  const { clipboard } = navigator as { clipboard?: Clipboard };
  try {
    await clipboard?.writeText(text);
    return clipboard !== undefined || copiedFromField(text);
  } catch {
    return copiedFromField(text);
  }
}

/** Copy from a field that exists only for this. */
function copiedFromField(text: string): boolean {
  const focused = document.activeElement;
  const field = document.createElement("textarea");
  field.className = "unseen";
  field.value = text;
  document.body.append(field);
  field.select();
  const done = document.execCommand("copy");
  field.remove();
  if (focused instanceof HTMLElement) focused.focus();
  return done;
}
