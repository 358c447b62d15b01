/** Space between a revealed element and the edge of the free area, pixels. */
const MARGIN = 8;

/** Return the height of the bar if it covers the top of the page, else 0; pixels. */
function coveredByBar(): number {
  const bar = document.querySelector<HTMLElement>(".bar");
  return bar !== null && ["sticky", "fixed"].includes(getComputedStyle(bar).position) ? bar.offsetHeight : 0;
}

/** Keep an element that sticks to the top of the page below the bar; return a function that ends this. */
export function keepBelowBar(element: HTMLElement): () => void {
  const bar = document.querySelector<HTMLElement>(".bar");
  const resized = new ResizeObserver(() => (element.style.top = `${coveredByBar() + MARGIN}px`));
  if (bar !== null) resized.observe(bar);
  return () => resized.disconnect();
}

/** Scroll the page until an element is visible below the bar, which covers the top of the page. */
export function reveal(element: HTMLElement): void {
  const free = { top: coveredByBar() + MARGIN, bottom: innerHeight - MARGIN };
  const { top, bottom } = element.getBoundingClientRect();
  // If the element does not fit, its upper edge counts.
  const [above, below] = [top - free.top, Math.min(bottom - free.bottom, top - free.top)];
  if (above < 0) scrollBy(0, above);
  else if (below > 0) scrollBy(0, below);
}

/** Scroll to an element of the lists beside the picture. Where the picture is above them, it would scroll away. */
export function revealBeside(element: HTMLElement): void {
  if (!matchMedia("(max-width: 62rem)").matches) reveal(element); // as in result.css
}
