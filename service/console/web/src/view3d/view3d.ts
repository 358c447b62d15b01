import type { Scheme } from "./palette";
import type { Caption } from "./picture";
import type { Content, Layer, Target } from "./scene";
import { Stage } from "./stage";

export { NoWebGLError } from "./graphics";
export type { Scheme } from "./palette";
export type { Content, Layer, Lens, Other, PlannedPath, Target, CellGeometry, HeightMap, ViewPose } from "./scene";

/** Events for the page. */
export interface Callbacks {
  /** A person selected a target. */
  picked(target: Target): void;
}

/** The 3D view of a result and its cell. It moves nothing. */
export interface View3D {
  /** Replace the content. The camera keeps its pose if the model is the same. */
  show(content: Content): void;
  layers(shown: ReadonlySet<Layer>): void;
  /** Set the joint angles of the arm. */
  arm(q_rad: readonly number[] | null): void;
  /** Highlight a target. */
  mark(target: Target | null): void;
  /** Highlight a target, and turn the camera to it. */
  focus(target: Target): void;
  viewFrom(from: "fit" | "top" | "side"): void;
  /** Zoom in by a factor above 1, or out. */
  zoom(factor: number): void;
  /** Rotate about the centre of the view: to the left, and up. */
  rotate(dx_rad: number, dy_rad: number): void;
  /** Return the picture as it is now, with its labels and a caption, as a PNG. */
  picture(caption: Caption): Promise<Blob>;
  scheme(scheme: Scheme): void;
  dispose(): void;
}

/**
 * Draw on a canvas, with the labels in the element `labels` above it. Their styles are in view3d.css.
 *
 * `canvas.dataset.frames` counts the drawn frames, `canvas.dataset.points` the points of the cloud,
 * `canvas.dataset.viewClouds` the views of a running scan whose points are drawn, and
 * `canvas.dataset.joints` has the joint angles of the drawn arm.
 *
 * @throws NoWebGLError when the browser has none.
 */
export function open3D(canvas: HTMLCanvasElement, labels: HTMLElement, callbacks: Callbacks): View3D {
  return new Stage(canvas, labels, (target) => callbacks.picked(target));
}
