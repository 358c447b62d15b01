import { type Color, CylinderGeometry, Mesh, MeshBasicMaterial, Vector3 } from "three";

/** Draw a thin cylinder between two points. */
export function rod(from: Vector3, to: Vector3, radius_m: number, colour: Color): Mesh {
  const way = to.clone().sub(from);
  const shape = new CylinderGeometry(radius_m, radius_m, Math.max(way.length(), 1e-6), 8);
  const mesh = new Mesh(shape, new MeshBasicMaterial({ color: colour }));
  mesh.position.copy(from).addScaledVector(way, 0.5);
  mesh.quaternion.setFromUnitVectors(new Vector3(0, 1, 0), way.normalize());
  return mesh;
}
