import { effect } from "@preact/signals";
import { render } from "preact";
import "./console.css";
import "./view3d/view3d.css";
import { App, screenKeys } from "./app";
import { Status } from "./bar/status";
import { atWork } from "./state/cell";
import { follow } from "./state/follow";
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
// What the last stop did is no news any more once the arm is at work again.
let before = false;
effect(() => {
  if (atWork.value && !before) forgetStop();
  before = atWork.value;
});
follow();
