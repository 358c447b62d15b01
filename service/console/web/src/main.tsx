import { computed, effect } from "@preact/signals";
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
// What the last stop did is no news any more once the arm is at work again, or somebody else has signed in.
effect(() => {
  if (atWork.value) forgetStop();
});
const fault = computed(() => cell.value?.state === "fault");
let faulty = false;
effect(() => {
  if (faulty && !fault.value) forgetStop(); // somebody has looked at the arm
  faulty = fault.value;
});
const who = computed(() => caller.value?.name);
effect(() => {
  if (who.value !== undefined) forgetStop();
});
follow();
