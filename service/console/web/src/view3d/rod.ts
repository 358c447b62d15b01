import { type Color, ConeGeometry, CylinderGeometry, Group, Mesh, MeshBasicMaterial, Vector3 } from "three";

const UP = new Vector3(0, 1, 0);
/** Size of an arrow's tip, in radii of its rod. */
const [TIP_WIDTH, TIP_LENGTH] = [3, 8];

/** Draw a thin cylinder between two points. */
export function rod(from: Vector3, to: Vector3, radius_m: number, colour: Color): Mesh {
  const way = to.clone().sub(from);
  const shape = new CylinderGeometry(radius_m, radius_m, Math.max(way.length(), 1e-6), 8);
  const mesh = new Mesh(shape, new MeshBasicMaterial({ color: colour }));
  mesh.position.copy(from).addScaledVector(way, 0.5);
  mesh.quaternion.setFromUnitVectors(UP, way.normalize());
  return mesh;
}

/** Draw an arrow from a point to another one, with its tip there. */
export function arrow(from: Vector3, to: Vector3, radius_m: number, colour: Color): Group {
  const way = to.clone().sub(from);
  const length = Math.min(TIP_LENGTH * radius_m, way.length());
  way.normalize();
  const neck = to.clone().addScaledVector(way, -length);
  const tip = new Mesh(new ConeGeometry(TIP_WIDTH * radius_m, length, 12), new MeshBasicMaterial({ color: colour }));
  tip.position.copy(neck).addScaledVector(way, length / 2);
  tip.quaternion.setFromUnitVectors(UP, way);
  return new Group().add(rod(from, neck, radius_m, colour), tip);
}
