import { signal } from "@preact/signals";

/** The screens. */
export const SCREENS = ["scan", "result", "history", "calibration"] as const;
export type Screen = (typeof SCREENS)[number];

/** Where the page is, as `#/result/ID`. */
export interface Route {
  screen: Screen;
  /** Of the scan that the screen is about. */
  id: string | null;
}

/** The route that an address names behind its #. */
function routeOf(hash: string): Route {
  const [name, id] = hash.replace(/^#\/?/, "").split("/");
  const screen = SCREENS.find((one) => one === name) ?? "scan";
  return { screen, id: id ? decodeURIComponent(id) : null };
}

/** The address of a screen. */
export function addressOf(screen: Screen, id: string | null = null): string {
  return id === null ? `#/${screen}` : `#/${screen}/${encodeURIComponent(id)}`;
}

/** Where the page is now. */
export const route = signal(routeOf(location.hash));
addEventListener("hashchange", () => {
  route.value = routeOf(location.hash);
  scrollTo(0, 0);
});

/** Goes to a screen. */
export function go(screen: Screen, id: string | null = null): void {
  location.hash = addressOf(screen, id);
}

/** Names the scan that a screen has found to be about, unless somebody has gone elsewhere meanwhile. */
export function settle(screen: Screen, id: string): void {
  // Not `route`: that hears of a change a moment later.
  const at = routeOf(location.hash);
  if (at.screen === screen && at.id === null) location.replace(addressOf(screen, id));
}
