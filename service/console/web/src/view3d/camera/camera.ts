import { DirectionalLight, PerspectiveCamera, TOUCH, Vector3 } from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { DIRECTIONS, type Framing, framing, UP } from "./framing";

const FOV_RAD = 0.6;
const [NEAR_M, FAR_M] = [0.005, 20];
/** From below the table, over and under would look swapped. */
const LOWEST_RAD = Math.PI / 2 - 0.01;
const [NEAREST_M, FARTHEST_M] = [0.02, 6];

/** An orbit camera with the z axis up and a light beside it. */
export class Orbit {
  readonly camera = new PerspectiveCamera((FOV_RAD * 180) / Math.PI, 1, NEAR_M, FAR_M);
  private readonly controls: OrbitControls;

  constructor(element: HTMLElement, moved: () => void) {
    this.camera.up.copy(UP);
    const light = new DirectionalLight(0xffffff, 1.6);
    light.position.set(-0.4, 0.8, 1);
    this.camera.add(light, light.target);
    this.controls = new OrbitControls(this.camera, element);
    this.controls.minDistance = NEAREST_M;
    this.controls.maxDistance = FARTHEST_M;
    this.controls.maxPolarAngle = LOWEST_RAD;
    // A finger that moves up or down scrolls the page; two fingers turn and zoom.
    this.controls.touches.TWO = TOUCH.DOLLY_ROTATE;
    element.style.touchAction = "pan-y";
    this.place({ position: DIRECTIONS.fit.clone().multiplyScalar(0.5), target: new Vector3() });
    this.controls.addEventListener("change", moved);
  }

  setAspect(aspect: number): void {
    this.camera.aspect = aspect;
    this.camera.updateProjectionMatrix();
  }

  /** Fit all points from a direction, the present one if none is given; return whether there were any. */
  fit(points: readonly Vector3[], from = this.direction()): boolean {
    const framed = framing(points, from, FOV_RAD, this.camera.aspect);
    if (framed) this.place(framed);
    return framed !== null;
  }

  /** Turn to a point, and approach it until a radius around it fills the view. */
  approach(point: Vector3, around_m: number): void {
    const from = this.direction();
    const distance = (1.5 * around_m) / Math.tan(FOV_RAD / 2) / Math.min(1, this.camera.aspect);
    this.place({ position: point.clone().addScaledVector(from, distance), target: point });
  }

  /** Zoom in by a factor above 1, or out. */
  zoom(factor: number): void {
    this.controls.dollyOut(factor);
  }

  rotate(dx_rad: number, dy_rad: number): void {
    this.controls.rotateLeft(dx_rad);
    this.controls.rotateUp(dy_rad);
  }

  /** Distance of the camera from its target, metres. */
  get distance_m(): number {
    return this.controls.getDistance();
  }

  dispose(): void {
    this.controls.dispose();
  }

  /** Return the direction from the target to the camera. */
  private direction(): Vector3 {
    return this.camera.position.clone().sub(this.controls.target).normalize();
  }

  private place({ position, target }: Framing): void {
    this.camera.position.copy(position);
    this.controls.target.copy(target);
    this.controls.update();
  }
}
