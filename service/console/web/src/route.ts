import { signal } from "@preact/signals";

/** The screens. */
export const SCREENS = ["scan", "result", "history", "calibration"] as const;
export type Screen = (typeof SCREENS)[number];

/** The screen that is shown, in the address as `#/result/ID`. */
export interface Route {
  screen: Screen;
  /** ID of the scan that the screen shows. */
  id: string | null;
}

/** Parse the part of an address after its #. */
function routeOf(hash: string): Route {
  const [name, id] = hash.replace(/^#\/?/, "").split("/");
  const screen = SCREENS.find((one) => one === name) ?? "scan";
  return { screen, id: id ? decodeURIComponent(id) : null };
}

/** Return the address of a screen. */
export function addressOf(screen: Screen, id: string | null = null): string {
  return id === null ? `#/${screen}` : `#/${screen}/${encodeURIComponent(id)}`;
}

/** The current route. */
export const route = signal(routeOf(location.hash));
addEventListener("hashchange", () => {
  route.value = routeOf(location.hash);
  scrollTo(0, 0);
});

/** Open a screen. */
export function go(screen: Screen, id: string | null = null): void {
  location.hash = addressOf(screen, id);
}

/** Add the scan's ID to the address, unless another screen or scan was opened meanwhile. */
export function replaceRoute(screen: Screen, id: string): void {
  // `route` is updated a moment after the address.
  const at = routeOf(location.hash);
  if (at.screen === screen && at.id === null) location.replace(addressOf(screen, id));
}
