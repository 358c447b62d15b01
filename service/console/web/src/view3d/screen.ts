import { type PerspectiveCamera, Vector3 } from "three";
import type { Rectangle } from "./rectangle";
import type { Chain } from "./scene";

/** A canvas and its camera; pixels from the upper left. */
export interface Screen {
  camera: PerspectiveCamera;
  width: number;
  height: number;
}

/** Where a point of the scene is seen: pixels, and metres before the camera (negative: behind it). */
export interface Seen {
  x: number;
  y: number;
  ahead_m: number;
}

/** Where a point is seen, base frame. */
export function seenAt(point: Vector3, { camera, width, height }: Screen): Seen {
  const before = point.clone().applyMatrix4(camera.matrixWorldInverse);
  const seen = before.clone().applyMatrix4(camera.projectionMatrix);
  return { x: ((seen.x + 1) / 2) * width, y: ((1 - seen.y) / 2) * height, ahead_m: -before.z };
}

/** Pixels of a metre at a metre's distance. */
export function pixelsAhead({ camera, height }: Screen): number {
  return height / (2 * Math.tan((camera.fov * Math.PI) / 360));
}

/** The parts of the screen that strings cover. */
export function covered(chains: readonly Chain[], screen: Screen): Rectangle[] {
  const perMetre = pixelsAhead(screen);
  return chains.flatMap((chain) =>
    chain.points.flatMap((point) => {
      const { x, y, ahead_m } = seenAt(new Vector3().fromArray(point), screen);
      const half = (perMetre * chain.radius_m) / ahead_m;
      return ahead_m > 0 ? [{ left: x - half, right: x + half, top: y - half, bottom: y + half }] : [];
    }),
  );
}
