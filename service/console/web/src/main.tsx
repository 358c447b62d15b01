import { effect } from "@preact/signals";
import { render } from "preact";
import "./console.css";
import "./view3d/view3d.css";
import { App, screenKeys } from "./app";
import { Status } from "./bar/status";
import { atWork, cell } from "./state/cell";
import { follow } from "./state/follow";
import { caller } from "./state/session";
import { forgetStop } from "./stop";

function show(part: preact.ComponentChild, id: string): void {
  const element = document.getElementById(id);
  if (element === null) throw new Error(`the page has no #${id}`);
  element.replaceChildren();
  render(part, element);
}

show(<Status />, "status");
show(<App />, "app");
addEventListener("keydown", screenKeys);
// What the last stop did is no news any more when the arm is at work again, has been looked at, or somebody signs in.
whenItBecomes(() => atWork.value, forgetStop);
whenItBecomes(() => cell.value?.state !== "fault", forgetStop);
whenItBecomes(() => caller.value !== null, forgetStop);
follow();

/** Acts whenever it is so and was not so before. */
function whenItBecomes(so: () => boolean, act: () => void): void {
  let before = true;
  effect(() => {
    const now = so();
    if (now && !before) act();
    before = now;
  });
}
