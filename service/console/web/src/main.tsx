import { render } from "preact";
import "./console.css";
import "./view3d/view3d.css";
import { App, screenKeys } from "./app";
import { Status } from "./bar/status";
import { follow } from "./state/follow";

function show(part: preact.ComponentChild, id: string): void {
  const element = document.getElementById(id);
  if (element === null) throw new Error(`the page has no #${id}`);
  element.replaceChildren();
  render(part, element);
}

show(<Status />, "status");
show(<App />, "app");
addEventListener("keydown", screenKeys);
follow();
