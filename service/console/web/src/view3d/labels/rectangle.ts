/** Part of the canvas, pixels. */
export interface Rectangle {
  left: number;
  right: number;
  top: number;
  bottom: number;
}

/** Return a rectangle at the distance `off` from a point: to its right for the direction [1, 0], above for [0, -1]. */
export function rectangleBeside(
  at: { x: number; y: number },
  [width, height]: readonly [number, number],
  way: readonly [number, number],
  off: number,
): Rectangle {
  const left = at.x + way[0] * (off + width / 2) - width / 2;
  const top = at.y + way[1] * (off + height / 2) - height / 2;
  return { left, right: left + width, top, bottom: top + height };
}

/** Return whether two rectangles overlap. */
export function overlap(a: Rectangle, b: Rectangle): boolean {
  return a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
}

/** Return a rectangle, moved so that it is on a screen. */
export function movedInside(area: Rectangle, { width, height }: { width: number; height: number }): Rectangle {
  const dx = Math.max(0, -area.left) - Math.max(0, area.right - width);
  const dy = Math.max(0, -area.top) - Math.max(0, area.bottom - height);
  return { left: area.left + dx, right: area.right + dx, top: area.top + dy, bottom: area.bottom + dy };
}

/** Return whether a rectangle is on a screen. */
export function inside(area: Rectangle, { width, height }: { width: number; height: number }): boolean {
  return area.left >= 0 && area.top >= 0 && area.right <= width && area.bottom <= height;
}
