import { useEffect, useState } from "preact/hooks";
import { takeSlot } from "../net/slots";

interface PictureProps {
  src: string;
  alt: string;
  class?: string;
}

/** A picture of the service's, loaded in one of the slots, so that many of them keep no stop waiting. */
export function Picture({ src, alt, class: name }: PictureProps) {
  const [slot, setSlot] = useState<Awaited<ReturnType<typeof takeSlot>> | null>(null);
  const [given, setGiven] = useState<"waiting" | "shown" | "missing">("waiting");
  useEffect(() => {
    let mine: typeof slot = null;
    let gone = false;
    setGiven("waiting");
    void takeSlot().then((taken) => {
      mine = taken;
      if (gone) return taken.free();
      taken.signal.addEventListener("abort", () => {
        setSlot(null); // takes the picture's request back
        taken.free();
      });
      setSlot(taken);
    });
    return () => {
      gone = true;
      mine?.free();
      setSlot(null);
    };
  }, [src]);
  const done = (how: "shown" | "missing") => {
    slot?.free();
    setGiven(how);
  };
  if (given === "missing") return <span class={`picture none ${name ?? ""}`}>no picture</span>;
  return slot === null ? (
    <span class={`picture ${name ?? ""}`} />
  ) : (
    <img class={`picture ${name ?? ""}`} src={src} alt={alt} onLoad={() => done("shown")} onError={() => done("missing")} />
  );
}
