import type { Model } from "../net/api";
import type { Place } from "../view3d/scene";
import { sentence } from "../words/sentence";
import { counted } from "../words/units";
import { placeIn } from "./places";

/** What to know before anything is grasped: a press turns the view to it. */
export function Findings({ model, show }: { model: Model; show: (place: Place) => void }) {
  const { ambiguities, warnings, views } = model.quality;
  const found = [...ambiguities, ...warnings];
  const unused = views.filter((view) => !view.used);
  const unseen = model.chains.filter((chain) => chain.ends.includes("unseen"));
  const count = found.length + unused.length + unseen.length;
  if (count === 0) {
    return <p class="note good">✓ Nothing was found that speaks against this result.</p>;
  }
  return (
    <section aria-label="Findings">
      <h2 class="warn">
        ▲ {model.chains.length === 0 ? "Why there is no string" : `${counted(count, "thing")} to know before you grasp`}
      </h2>
      <ul class="places">
        {found.map((words) => (
          <li key={words}>
            <Finding words={words} show={show} />
          </li>
        ))}
        {unseen.map((chain) => (
          <li key={`string ${chain.id}`}>
            <button type="button" onClick={() => show({ kind: "chain", id: chain.id })}>
              String {chain.id} was not seen to end at {chain.ends[0] === chain.ends[1] ? "either end" : "one end"}: it may go on
              there, or belong to another string.
            </button>
          </li>
        ))}
        {unused.length < views.length &&
          unused.map((view) => (
            <li key={view.index}>
              <button type="button" onClick={() => show({ kind: "view", index: view.index })}>
                {sentence(`View ${view.index} was not used: ${view.reason ?? "no reason is told"}`)}
              </button>
            </li>
          ))}
      </ul>
      {unused.length === views.length && <p>None of the {counted(views.length, "view")} shows anything of a string.</p>}
    </section>
  );
}

function Finding({ words, show }: { words: string; show: (place: Place) => void }) {
  const place = placeIn(words);
  if (place === null) return <p class="note warn">{sentence(words)}</p>;
  return (
    <button type="button" onClick={() => show(place)}>
      {sentence(words)}
    </button>
  );
}
