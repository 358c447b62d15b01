import { Group, Mesh, MeshBasicMaterial, SphereGeometry, Vector3 } from "three";
import { mm } from "../../texts/format";
import { t } from "../../texts/translate";
import { distance } from "./arc_length";
import { label } from "../labels/labels";
import { overEverything } from "../over_everything";
import type { Palette } from "../palette";
import { rod } from "../rod";
import type { Measured } from "../scene";

const [LINE_M, BALL_M] = [0.0007, 0.0025];

/** Draw the measured distance over everything else: a ball at each end, a line between them, and its length. */
export function drawMeasured(measured: Measured | null, palette: Palette): Group {
  const group = new Group();
  if (measured === null) return group;
  const from = new Vector3().fromArray(measured.from);
  const ends = measured.to === null ? [from] : [from, new Vector3().fromArray(measured.to)];
  for (const end of ends) {
    const ball = new Mesh(new SphereGeometry(BALL_M, 16, 10), new MeshBasicMaterial({ color: palette.measured }));
    ball.position.copy(end);
    group.add(ball);
  }
  const [, to] = ends;
  if (measured.to === null || to === undefined) {
    group.add(label({ brief: t("viewer.label.measured_from"), kind: "measured", rank: -1 }, from));
  } else {
    const text = mm(distance(measured.from, measured.to));
    const middle = from.clone().lerp(to, 0.5);
    group.add(rod(from, to, LINE_M, palette.measured), label({ brief: text, kind: "measured", rank: -1 }, middle));
  }
  return overEverything(group, 40);
}
