/** Part of the canvas, pixels. */
export interface Rectangle {
  left: number;
  right: number;
  top: number;
  bottom: number;
}

/** One of a size that stands `off` a point: to its right where `way` is [1, 0], above it where that is [0, -1]. */
export function besides(
  at: { x: number; y: number },
  [width, height]: readonly [number, number],
  way: readonly [number, number],
  off: number,
): Rectangle {
  const left = at.x + way[0] * (off + width / 2) - width / 2;
  const top = at.y + way[1] * (off + height / 2) - height / 2;
  return { left, right: left + width, top, bottom: top + height };
}

/** Whether two have pixels in common. */
export function overlap(a: Rectangle, b: Rectangle): boolean {
  return a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
}

/** Whether all of it is on a screen. */
export function inside(area: Rectangle, { width, height }: { width: number; height: number }): boolean {
  return area.left >= 0 && area.top >= 0 && area.right <= width && area.bottom <= height;
}
