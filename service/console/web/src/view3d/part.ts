import { type Group, InstancedMesh, type Mesh, type Object3D, type Scene } from "three";
import { CSS2DObject } from "three/examples/jsm/renderers/CSS2DRenderer.js";

/** A part of the scene: drawn anew when what it shows has changed, and only then. */
export class Part<Shown extends readonly unknown[]> {
  private shown: Shown | null = null;
  /** What is drawn; null before the first time. */
  group: Group | null = null;

  constructor(
    private readonly scene: Scene,
    private readonly draw: (...shown: Shown) => Group,
  ) {}

  /** Draws these, unless they are the ones drawn. */
  update(...shown: Shown): void {
    if (this.shown?.every((value, index) => Object.is(value, shown[index]))) return;
    const before = this.group;
    this.shown = shown;
    this.group = this.draw(...shown);
    this.group.visible = before?.visible ?? true;
    this.scene.add(this.group);
    if (before) discard(before); // after the new one is there: their shaders are the same, and stay
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

/** Takes a group out of its scene, and its shapes out of the graphics' memory. */
function discard(group: Object3D): void {
  group.traverse((object) => {
    if (object instanceof CSS2DObject) object.element.remove();
    if (object instanceof InstancedMesh) object.dispose();
    const { geometry, material } = object as Partial<Mesh>; // lines and points have them as well
    geometry?.dispose();
    for (const one of [material ?? []].flat()) one.dispose();
  });
  group.removeFromParent();
}
