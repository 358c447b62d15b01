import { type Group, Mesh } from "three";

/** Draw the meshes of a group over everything that has a lower order. */
export function overEverything(group: Group, order: number): Group {
  group.traverse((part) => {
    if (!(part instanceof Mesh)) return;
    part.material.depthTest = false;
    part.renderOrder = order;
  });
  return group;
}
