import { useEffect, useState } from "preact/hooks";
import { takeSlot, type Slot } from "../net/slots";

/** Behind so long without an answer, the slot is wanted for others. */
const LIMIT_MS = 30_000;
const AGAIN_MS = 1000;

interface PictureProps {
  src: string;
  alt: string;
  class?: string;
}

/** A picture of the service's, loaded in one of the slots, so that many of them keep no stop waiting. */
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
        }, LIMIT_MS),
      );
      taken.signal.addEventListener("abort", () => {
        taken.free();
        setSlot(null); // takes the picture's request back
        timers.push(setTimeout(() => setTries(tries + 1), AGAIN_MS));
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
  if (state === "missing") return <span class={`picture none ${name}`}>no picture</span>;
  if (slot === null) return <span class={`picture ${name}`} />;
  return <img class={`picture ${name}`} src={src} alt={alt} onLoad={() => done("shown")} onError={() => done("missing")} />;
}
