import type { Model } from "../net/api";
import type { Place } from "../view3d/scene";
import { mm } from "../words/units";

interface ListProps {
  model: Model;
  /** Turns the view to a place. */
  show: (place: Place) => void;
}

/** Each string in short. */
export function Strings({ model, show }: ListProps) {
  return (
    <section>
      <h2>Strings</h2>
      <ul class="places">
        {model.chains.map((chain) => (
          <li key={chain.id}>
            <button type="button" onClick={() => show({ kind: "chain", id: chain.id })}>
              String {chain.id}: {mm(chain.length_m, 0)} long, {mm(2 * chain.radius_m)} thick,{" "}
              {chain.closed ? "closed" : `ends ${chain.ends.join(" and ")}`}
            </button>
          </li>
        ))}
      </ul>
    </section>
  );
}
