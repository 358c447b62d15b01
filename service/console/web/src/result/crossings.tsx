import type { Model } from "../net/api";
import { Hint } from "../ui/hint";
import { SURE, type Place } from "../view3d/scene";
import { degrees, mm, percent } from "../words/units";

interface ListProps {
  model: Model;
  /** Turns the view to a place. */
  show: (place: Place) => void;
}

/** Which strand lies over which, in words. */
export function Crossings({ model, show }: ListProps) {
  if (model.crossings.length === 0) return null;
  return (
    <section>
      <h2>
        <Hint term="crossing">Crossings</Hint>
      </h2>
      <ul class="places">
        {model.crossings.map(({ id, over, under, gap_m, angle_rad, confidence }) => (
          <li key={id}>
            <button type="button" class={confidence < SURE ? "unsure" : ""} onClick={() => show({ kind: "crossing", id })}>
              {id}: string {over.chain} at {mm(over.s_m, 0)} lies <strong>over</strong> string {under.chain} at{" "}
              {mm(under.s_m, 0)}. Heights differ by {mm(gap_m)}, angle {degrees(angle_rad)},{" "}
              {sureness(confidence)}
            </button>
          </li>
        ))}
      </ul>
    </section>
  );
}

/** Nothing measured is wholly sure. */
function sureness(confidence: number): string {
  if (confidence < SURE) return `not certain: ${percent(confidence)} sure`;
  return confidence > 0.99 ? "more than 99 % sure" : `${percent(confidence)} sure`;
}
