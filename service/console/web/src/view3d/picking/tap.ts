/** A finger that moves further than this, in pixels, turns the view instead of selecting. */
const STILL = 8;

/** Call back on taps and clicks, pixels from the upper left of an element; return a function that ends this. */
export function onTap(element: HTMLElement, tapped: (x: number, y: number) => void): () => void {
  let down: { id: number; x: number; y: number } | null = null;
  const ends = new AbortController();
  const { signal } = ends;
  element.addEventListener(
    "pointerdown",
    (event) => {
      // A second finger turns or zooms the view.
      down = event.isPrimary && event.button === 0 ? { id: event.pointerId, x: event.clientX, y: event.clientY } : null;
    },
    { signal },
  );
  element.addEventListener(
    "pointerup",
    (event) => {
      if (down === null || down.id !== event.pointerId) return;
      const still = Math.hypot(event.clientX - down.x, event.clientY - down.y) <= STILL;
      down = null;
      const area = element.getBoundingClientRect();
      if (still) tapped(event.clientX - area.left, event.clientY - area.top);
    },
    { signal },
  );
  element.addEventListener("pointercancel", () => (down = null), { signal });
  return () => ends.abort();
}
