import { signal } from "@preact/signals";

/** The screens. */
export const SCREENS = ["scan", "result", "history", "calibration"] as const;
export type Screen = (typeof SCREENS)[number];

/** The screen that is shown, in the address as `#/result/ID`, or the page to sign in, as `#/sign-in/CODE`. */
export interface Route {
  screen: Screen;
  /** ID of the scan that the screen shows. */
  id: string | null;
  /** Code in the address of the page to sign in, or an empty string; null: another address. */
  signInCode: string | null;
}

const SIGN_IN = "sign-in";

/** Parse the part of an address after its #. */
function routeOf(hash: string): Route {
  const [name, rest = ""] = hash.replace(/^#\/?/, "").split("/");
  if (name === SIGN_IN) return { screen: "scan", id: null, signInCode: decoded(rest) };
  const screen = SCREENS.find((one) => one === name) ?? "scan";
  return { screen, id: rest ? decoded(rest) : null, signInCode: null };
}

function decoded(text: string): string {
  try {
    return decodeURIComponent(text);
  } catch {
    return text; // a % that is no escape
  }
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

/** Remove the code from the address and from the history, and stay on the page to sign in. */
export function removeSignInCode(): void {
  if (route.value.signInCode !== null) replaceAddress(`#/${SIGN_IN}`);
}

/** Leave the page to sign in, if the address is its own. */
export function leaveSignIn(): void {
  if (route.value.signInCode !== null) replaceAddress(addressOf("scan"));
}

function replaceAddress(hash: string): void {
  history.replaceState(null, "", hash);
  route.value = routeOf(hash);
}
