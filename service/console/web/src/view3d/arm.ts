import {
  CapsuleGeometry, type Color, Group, LessDepth, Mesh, MeshBasicMaterial, MeshLambertMaterial, Vector3,
} from "three";
import { linkFrames } from "./kinematics";
import type { Palette } from "./palette";
import type { ArmPart, ArmShape, Room } from "./scene";

const STRETCHED = [0, 0, 0, 0, 0, 0];
const Y = new Vector3(0, 1, 0);

/** Draw the arm with its camera as the collision capsules of the service. `poseArm` sets its pose. */
export function drawArm(room: Room | null, palette: Palette): Group {
  const group = new Group();
  if (room === null) return group;
  for (const [part, [from, to]] of partEnds(room.arm, STRETCHED)) {
    // The length of a part does not depend on the joint angles.
    const shape = new CapsuleGeometry(part.radius_m, from.distanceTo(to), 12, 36);
    group.add(new Group().add(...glass(shape, palette.arm, group.children.length)));
  }
  return group;
}

/**
 * Return a translucent mesh that hides the overlap with its neighbours: depths are drawn first, slightly behind.
 *
 * Where surfaces coincide, the one with the lowest number is visible.
 */
function glass(shape: CapsuleGeometry, colour: Color, number: number): Mesh[] {
  const both = { transparent: true, polygonOffset: true };
  const deep = new MeshBasicMaterial({ ...both, polygonOffsetUnits: 400, colorWrite: false });
  const clear = new MeshLambertMaterial({ ...both, polygonOffsetUnits: 20 * number, color: colour, opacity: 0.5 });
  clear.depthFunc = LessDepth;
  const [depths, surface] = [new Mesh(shape, deep), new Mesh(shape, clear)];
  depths.renderOrder = 1;
  surface.renderOrder = 2 + number;
  return [depths, surface];
}

/** Move the drawn arm to joint angles. */
export function poseArm(group: Group, arm: ArmShape, q_rad: readonly number[]): void {
  partEnds(arm, q_rad).forEach(([, [from, to]], index) => {
    const body = group.children[index];
    if (!body) return;
    body.position.copy(from).lerp(to, 0.5);
    const way = to.clone().sub(from);
    if (way.lengthSq() > 0) body.quaternion.setFromUnitVectors(Y, way.normalize());
  });
}

/** Return the ends of each part's axis at joint angles, base frame. */
export function partEnds(arm: ArmShape, q_rad: readonly number[]): [ArmPart, [Vector3, Vector3]][] {
  const frames = linkFrames(arm, q_rad);
  return arm.parts.map((part) => {
    const end = (which: 0 | 1) => {
      const point = new Vector3().fromArray(part.ends_m[which] ?? [0, 0, 0]);
      const frame = frames[part.frames[which] ?? 0];
      return frame ? point.applyMatrix4(frame) : point;
    };
    return [part, [end(0), end(1)]];
  });
}
