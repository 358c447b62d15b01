import type { Scheme } from "./palette";
import type { Content, Layer, Place } from "./scene";
import { Stage } from "./stage";

export { NoWebGLError } from "./graphics";
export type { Scheme } from "./palette";
export type { Content, Layer, Other, Place, Room, ViewPose } from "./scene";

/** What the page is told. */
export interface Callbacks {
  /** A person pointed at something. */
  picked(place: Place): void;
}

/** The 3D view of a result and its cell. It shows, and moves nothing. */
export interface View3D {
  /** Replaces all; the camera stays where it is when the model is the one shown. */
  show(content: Content): void;
  layers(shown: ReadonlySet<Layer>): void;
  /** Where the arm is now; cheap. */
  arm(q_rad: readonly number[] | null): void;
  /** Highlights a place. */
  mark(place: Place | null): void;
  /** Highlights a place and turns the camera to it. */
  focus(place: Place): void;
  look(from: "fit" | "top" | "side"): void;
  /** Above 1: nearer. */
  zoom(factor: number): void;
  /** Turns about what is looked at: to the left, and up. */
  rotate(dx_rad: number, dy_rad: number): void;
  scheme(scheme: Scheme): void;
  dispose(): void;
}

/**
 * Draws on a canvas, with `labels` lying over it: the style sheet view3d.css has its looks.
 *
 * `canvas.dataset.frames` counts what was drawn, `canvas.dataset.points` the cloud's points.
 *
 * @throws NoWebGLError when the browser has none.
 */
export function open3D(canvas: HTMLCanvasElement, labels: HTMLElement, callbacks: Callbacks): View3D {
  return new Stage(canvas, labels, (place) => callbacks.picked(place));
}
