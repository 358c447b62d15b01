import { type Group, InstancedMesh, type Mesh, MeshBasicMaterial, type Object3D, type Scene } from "three";
import { CSS2DObject } from "three/examples/jsm/renderers/CSS2DRenderer.js";

/** A part of the scene, drawn again only when its input has changed. */
export class Part<Shown extends readonly unknown[]> {
  private shown: Shown | null = null;
  /** The input that is drawn; null before the first time. */
  group: Group | null = null;

  constructor(
    private readonly scene: Scene,
    private readonly draw: (...shown: Shown) => Group,
  ) {}

  /** Draw an input, unless it is the drawn one. */
  update(...shown: Shown): void {
    if (this.shown?.every((value, index) => Object.is(value, shown[index]))) return;
    const before = this.group;
    this.shown = shown;
    this.group = this.draw(...shown);
    this.group.visible = before?.visible ?? true;
    this.scene.add(this.group);
    if (before) discard(before); // after the new one exists, so that the shared shaders stay
  }

  set visible(visible: boolean) {
    if (this.group) this.group.visible = visible;
  }

  dispose(): void {
    if (this.group) discard(this.group);
    this.group = null;
    this.shown = null;
  }
}

/** Remove a group from its scene, and free its graphics memory. */
function discard(group: Object3D): void {
  group.traverse((object) => {
    if (object instanceof CSS2DObject) object.element.remove();
    if (object instanceof InstancedMesh) object.dispose();
    const { geometry, material } = object as Partial<Mesh>; // lines and points have them as well
    geometry?.dispose();
    for (const one of [material ?? []].flat()) {
      if (one instanceof MeshBasicMaterial) one.map?.dispose();
      one.dispose();
    }
  });
  group.removeFromParent();
}
