import { useEffect, useRef, useState } from "preact/hooks";
import { t } from "../../texts/translate";

interface CopyProps {
  /** Copied as JSON: lengths in metres, angles in radians. */
  value: object;
  /** A position that can also be copied by itself, as people enter it at the pendant; metres, base frame. */
  point?: readonly number[];
}

/** Copies a value. */
export function Copy({ value, point }: CopyProps) {
  const [tried, setTried] = useState<{ text: string; done: boolean } | null>(null);
  const field = useRef<HTMLTextAreaElement>(null);
  const text = JSON.stringify(value, null, 1);
  useEffect(() => setTried(null), [text]);
  useEffect(() => {
    if (tried?.done === false) field.current?.select();
  }, [tried]);
  const copy = async (wanted: string) => {
    setTried(null);
    setTried({ text: wanted, done: await copied(wanted) });
  };
  return (
    <>
      <button type="button" onClick={() => copy(text)}>
        {t("result.copy.button")}
      </button>
      {point !== undefined && (
        <button type="button" onClick={() => copy(point.map((metres) => (metres * 1000).toFixed(1)).join(", "))}>
          {t("result.copy.position")}
        </button>
      )}
      <span role="status" class="good copied">
        {tried?.done === true && t("result.copy.copied")}
      </span>
      {tried?.done === false && (
        <label class="by-hand">
          {t("result.copy.by_hand")}
          <textarea ref={field} readOnly rows={5} value={tried.text} onFocus={(event) => event.currentTarget.select()} />
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
