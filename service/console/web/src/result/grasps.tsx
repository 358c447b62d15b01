import type { Model } from "../net/api";
import { Hint } from "../ui/hint";
import { BEST_GRASPS, type Place } from "../view3d/scene";
import { mm } from "../words/units";

/** What is farther away than this is not looked at. */
const FAR_M = 0.03;

/** The best places to take a string. */
export function Grasps({ model, show }: { model: Model; show: (place: Place) => void }) {
  return (
    <section>
      <h2>
        <Hint term="grasp">{model.grasps.length > BEST_GRASPS ? `The best ${BEST_GRASPS} of ${model.grasps.length} grasps` : "Grasps"}</Hint>
      </h2>
      {model.grasps.length === 0 && <p>There is no place where the gripper could take a string freely.</p>}
      <ul class="places">
        {model.grasps.slice(0, BEST_GRASPS).map((grasp, index) => (
          <li key={index}>
            <button type="button" onClick={() => show({ kind: "grasp", index })}>
              {index}: string {grasp.chain} at {mm(grasp.s_m, 0)}: fingers {mm(grasp.opening_m, 0)} apart, free by{" "}
              {mm(grasp.clearance_m, 0)}
              {grasp.clearance_m >= FAR_M && " or more"}
            </button>
          </li>
        ))}
      </ul>
    </section>
  );
}
