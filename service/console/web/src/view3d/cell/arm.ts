import {
  CapsuleGeometry, type Color, Group, LessDepth, Mesh, MeshBasicMaterial, MeshLambertMaterial, Vector3,
} from "three";
import { linkFrames } from "./kinematics";
import type { Palette } from "../palette";
import type { ArmCapsule, ArmGeometry, CellGeometry } from "../scene";

const STRETCHED = [0, 0, 0, 0, 0, 0];
const Y = new Vector3(0, 1, 0);

/** Draw the arm with its camera as the collision capsules of the service. `poseArm` sets its pose. */
export function drawArm(geometry: CellGeometry | null, palette: Palette): Group {
  const group = new Group();
  if (geometry === null) return group;
  for (const [capsule, [from, to]] of capsuleEnds(geometry.arm, STRETCHED)) {
    // The length of a capsule does not depend on the joint angles.
    const shape = new CapsuleGeometry(capsule.radius_m, from.distanceTo(to), 12, 36);
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
export function poseArm(group: Group, arm: ArmGeometry, q_rad: readonly number[]): void {
  capsuleEnds(arm, q_rad).forEach(([, [from, to]], index) => {
    const body = group.children[index];
    if (!body) return;
    body.position.copy(from).lerp(to, 0.5);
    const way = to.clone().sub(from);
    if (way.lengthSq() > 0) body.quaternion.setFromUnitVectors(Y, way.normalize());
  });
}

/** Return the ends of each capsule's axis at joint angles, base frame. */
export function capsuleEnds(arm: ArmGeometry, q_rad: readonly number[]): [ArmCapsule, [Vector3, Vector3]][] {
  const frames = linkFrames(arm, q_rad);
  return arm.capsules.map((capsule) => {
    const end = (which: 0 | 1) => {
      const point = new Vector3().fromArray(capsule.ends_m[which] ?? [0, 0, 0]);
      const frame = frames[capsule.frames[which] ?? 0];
      return frame ? point.applyMatrix4(frame) : point;
    };
    return [capsule, [end(0), end(1)]];
  });
}
