import { useEffect, useState } from "preact/hooks";
import { api, slowly, told } from "../net/api";
import { cell, why } from "../state/cell";
import { askNow } from "../state/follow";
import { lost } from "../state/freshness";
import { maintains } from "../state/session";
import { Failed, useAction } from "../ui/action";
import { WhatToDo } from "../ui/manual";
import checkFirst from "../words/check_first.json";
import { sentence } from "../words/sentence";

/** What to check before a fault is acknowledged. */
function checks(slug: string | null): readonly string[] {
  return checkFirst[(slug ?? "") as keyof typeof checkFirst] ?? checkFirst["motion-failed"];
}

/** After a fault: what happened, what to check, and, for a maintainer, that he has. On every screen. */
export function Fault() {
  if (cell.value?.state !== "fault") return null;
  return (
    <section class="panel fault" aria-label="Fault">
      <h2>{sentence(cell.value.reason ?? "There was a fault")}</h2>
      <p>Nothing moves before a maintainer has looked at the cell and acknowledges this. Check first:</p>
      <ol>
        {checks(why.value).map((check) => (
          <li key={check}>{check}</li>
        ))}
      </ol>
      <p>
        <WhatToDo problem={cell.value.problem} />
      </p>
      {maintains.value ? <Acknowledge /> : <p class="note warn">Ask a maintainer to look at the cell and acknowledge.</p>}
    </section>
  );
}

function Acknowledge() {
  const [looked, setLooked] = useState(false);
  const action = useAction();
  const wait_s = useCountdown(action.failure?.slug === "too-early" ? (action.failure.retryAfter_s ?? 1) : 0);
  return (
    <>
      <label class="tick">
        <input type="checkbox" checked={looked} onChange={(event) => setLooked(event.currentTarget.checked)} />
        I have looked at the cell, and all of this is so.
      </label>
      <button
        type="button"
        class="main"
        disabled={!looked || action.busy || wait_s > 0 || lost.value}
        onClick={() =>
          void action.run(async () => {
            cell.value = await told(api.POST("/api/cell/acknowledge", slowly));
            askNow();
          })
        }
      >
        {wait_s > 0 ? `The robot needs a moment: again in ${wait_s} s` : "Acknowledge: nothing moves"}
      </button>
      <Failed failure={action.failure} />
    </>
  );
}

/** Seconds until it is over, counting down whenever `from_s` is told anew. */
function useCountdown(from_s: number): number {
  const [left_s, setLeft] = useState(0);
  useEffect(() => {
    setLeft(from_s);
    const timer = setInterval(() => setLeft((before) => Math.max(0, before - 1)), 1000);
    return () => clearInterval(timer);
  }, [from_s]);
  return left_s;
}
