import type { Model } from "../net/api";
import { Hint } from "../ui/hint";
import { pointAt } from "../view3d/along";
import type { Place } from "../view3d/scene";
import { mm, place as inMm } from "../words/units";
import type { Chosen } from "../viewer/viewer";

interface PointProps {
  model: Model;
  place: Place | null;
  choose: (chosen: Chosen | null) => void;
}

/** The point of a string that was picked, and the way along it. */
export function Point({ model, place, choose }: PointProps) {
  const chain = place?.kind === "point" ? model.chains.find((one) => one.id === place.chain) : undefined;
  if (place?.kind !== "point" || chain === undefined) {
    return <p class="small">Press a string in the picture to read where it is, how far along, and how sure that is.</p>;
  }
  const { index } = pointAt(chain, place.s_m);
  const s_m = chain.arc_length_m[index] ?? 0;
  const views = chain.views[index] ?? 0;
  const step = (by: number) => {
    const count = chain.points.length;
    const next = chain.closed ? (index + by + count) % count : Math.min(count - 1, Math.max(0, index + by));
    choose({ place: { kind: "point", chain: chain.id, s_m: chain.arc_length_m[next] ?? 0 }, turn: false });
  };
  return (
    <section class="panel point" aria-label="Picked point">
      <h2>String {chain.id}, point {index}</h2>
      <dl>
        <dt>Place</dt>
        <dd>{inMm(chain.points[index] ?? [])}</dd>
        <dt>Along the string</dt>
        <dd>
          {mm(s_m)} of {mm(chain.length_m)}
        </dd>
        <dt>
          <Hint term="sigma">Sure to</Hint>
        </dt>
        <dd>± {mm(chain.sigma_m[index] ?? 0, 2)}</dd>
        <dt>Seen by</dt>
        <dd>{views === 0 ? "no view: bridged" : `${views} views`}</dd>
      </dl>
      <div class="row">
        <button type="button" onClick={() => step(-1)} aria-label="Point before">
          ◀
        </button>
        <button type="button" onClick={() => step(1)} aria-label="Next point">
          ▶
        </button>
        <button type="button" onClick={() => choose(null)}>
          Forget
        </button>
      </div>
    </section>
  );
}
