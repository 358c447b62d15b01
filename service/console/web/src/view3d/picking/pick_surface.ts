import { Matrix4, Vector3 } from "three";
import type { HeightMap, Target } from "../scene";
import type { Screen } from "../camera/screen";

/** Accuracy of a finger, pixels: points of the cloud are close together. */
const NEAR = 10;
/** Steps to the cell under the pointer. Where the height map is steep, more would not agree better. */
const STEPS = 3;

/** Return the point of the cloud that is nearest to the pointer; null if none is near. */
export function pickCloud(cloud: Float32Array, { camera, width, height }: Screen, x: number, y: number): Target | null {
  const m = new Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse).elements;
  const row = (k: number, a: number, b: number, c: number) =>
    (m[k] ?? 0) * a + (m[k + 4] ?? 0) * b + (m[k + 8] ?? 0) * c + (m[k + 12] ?? 0);
  let best = -1;
  let least = NEAR;
  for (let at = 0; at + 2 < cloud.length; at += 3) {
    const [a, b, c] = [cloud[at] ?? 0, cloud[at + 1] ?? 0, cloud[at + 2] ?? 0];
    const w = row(3, a, b, c);
    if (w <= 0) continue;
    const [u, v] = [((row(0, a, b, c) / w + 1) / 2) * width, ((1 - row(1, a, b, c) / w) / 2) * height];
    const far = Math.hypot(u - x, v - y);
    if (far < least) [best, least] = [at, far];
  }
  return best < 0 ? null : { kind: "at", point: [cloud[best] ?? 0, cloud[best + 1] ?? 0, cloud[best + 2] ?? 0] };
}

/** Return the measured cell of the height map under the pointer; null if there is none. */
export function pickHeights(map: HeightMap, { camera, width, height }: Screen, x: number, y: number): Target | null {
  const eye = new Vector3().setFromMatrixPosition(camera.matrixWorld);
  const towards = new Vector3((x / width) * 2 - 1, 1 - (y / height) * 2, 0.5).unproject(camera).sub(eye);
  let z_m: number | null = map.table_z_m;
  let hit = eye;
  for (let step = 0; step < STEPS && z_m !== null; step++) {
    const share: number = (z_m - eye.z) / towards.z;
    if (!(share > 0)) return null; // the pointer is above the horizon
    hit = eye.clone().addScaledVector(towards, share);
    z_m = map.z_m[Math.floor((hit.x - map.x_m) / map.cell_m)]?.[Math.floor((hit.y - map.y_m) / map.cell_m)] ?? null;
  }
  return z_m === null ? null : { kind: "at", point: [hit.x, hit.y, z_m] };
}
