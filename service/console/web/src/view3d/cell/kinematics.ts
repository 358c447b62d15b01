import { Matrix4 } from "three";
import type { ArmGeometry } from "../scene";

/**
 * Return the frames of base and links at joint angles: `[k]` maps link k's points to base; 0 is the base, 6 the flange.
 *
 * The Denavit-Hartenberg table is that of the service.
 */
export function linkFrames(arm: ArmGeometry, q_rad: readonly number[]): Matrix4[] {
  const frames = [new Matrix4()];
  let frame = new Matrix4();
  arm.alpha_rad.forEach((alpha, k) => {
    const [d, a, q] = [arm.d_m[k] ?? 0, arm.a_m[k] ?? 0, q_rad[k] ?? 0];
    // All twists are quarter turns: exact zeros instead of cos(pi / 2).
    const [ca, sa] = [Math.round(Math.cos(alpha)), Math.round(Math.sin(alpha))];
    const [c, s] = [Math.cos(q), Math.sin(q)];
    const step = new Matrix4(
      c, -s * ca,  s * sa, a * c,
      s,  c * ca, -c * sa, a * s,
      0,      sa,      ca,     d,
      0,       0,       0,     1,
    );
    frame = frame.clone().multiply(step);
    frames.push(frame);
  });
  return frames;
}
