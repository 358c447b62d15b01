import { type PerspectiveCamera, Vector3 } from "three";
import type { Rectangle } from "../labels/rectangle";
import type { Chain } from "../scene";

/** A canvas and its camera; pixels from the upper left. */
export interface Screen {
  camera: PerspectiveCamera;
  width: number;
  height: number;
}

/** Projection of a point: pixels, and metres before the camera (negative: behind it). */
export interface Seen {
  x: number;
  y: number;
  ahead_m: number;
}

/** Project a point of the base frame. */
export function project(point: Vector3, { camera, width, height }: Screen): Seen {
  const before = point.clone().applyMatrix4(camera.matrixWorldInverse);
  const projected = before.clone().applyMatrix4(camera.projectionMatrix);
  return { x: ((projected.x + 1) / 2) * width, y: ((1 - projected.y) / 2) * height, ahead_m: -before.z };
}

/** Return the pixels per metre at a distance of one metre. */
export function pixelsAhead({ camera, height }: Screen): number {
  return height / (2 * Math.tan((camera.fov * Math.PI) / 360));
}

/** Return the parts of the screen that strings cover. */
export function covered(chains: readonly Chain[], screen: Screen): Rectangle[] {
  const perMetre = pixelsAhead(screen);
  return chains.flatMap((chain) =>
    chain.points.flatMap((point) => {
      const { x, y, ahead_m } = project(new Vector3().fromArray(point), screen);
      const half = (perMetre * chain.radius_m) / ahead_m;
      return ahead_m > 0 ? [{ left: x - half, right: x + half, top: y - half, bottom: y + half }] : [];
    }),
  );
}
