import { useEffect, useState } from "preact/hooks";
import { takeSlot, type Slot } from "../net/slots";
import { t } from "../texts/translate";

/** A slot is freed for other requests after this time without an answer. */
const TIMEOUT_MS = 30_000;
const RETRY_MS = 1000;

interface PictureProps {
  src: string;
  alt: string;
  class?: string;
}

/** An image of the service, loaded in one of the slots so that images never delay a stop. */
export function Picture({ src, alt, class: name = "" }: PictureProps) {
  const [slot, setSlot] = useState<Slot | null>(null);
  const [state, setState] = useState<"waiting" | "shown" | "missing">("waiting");
  const [tries, setTries] = useState(0);

  useEffect(() => {
    const timers: ReturnType<typeof setTimeout>[] = [];
    let mine: Slot | null = null;
    let gone = false;
    setState("waiting");
    void takeSlot("picture").then((taken) => {
      if (gone) return taken.free();
      mine = taken;
      timers.push(
        setTimeout(() => {
          taken.free();
          setState((now) => (now === "shown" ? now : "missing"));
        }, TIMEOUT_MS),
      );
      taken.signal.addEventListener("abort", () => {
        taken.free();
        setSlot(null); // cancels the image's request
        timers.push(setTimeout(() => setTries(tries + 1), RETRY_MS));
      });
      setSlot(taken);
    });
    return () => {
      gone = true;
      timers.forEach(clearTimeout);
      mine?.free();
      setSlot(null);
    };
  }, [src, tries]);

  const done = (how: "shown" | "missing") => {
    slot?.free();
    setState(how);
  };
  if (state === "missing") return <span class={`picture none ${name}`}>{t("image.missing")}</span>;
  if (slot === null) return <span class={`picture ${name}`} />;
  return <img class={`picture ${name}`} src={src} alt={alt} onLoad={() => done("shown")} onError={() => done("missing")} />;
}
