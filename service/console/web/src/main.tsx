import { effect } from "@preact/signals";
import { render } from "preact";
import "./console.css";
import "./scan/scan.css";
import "./viewer/viewer.css";
import "./view3d/view3d.css";
import "./result/result.css";
import "./history/history.css";
import "./calibration/calibration.css";
import { App, screenKeys } from "./app";
import { Status } from "./bar/status";
import { atWork, cell } from "./state/cell";
import { applyLanguage, InLanguage } from "./state/language";
import { requesting, running } from "./state/scans";
import { caller } from "./state/session";
import { loaded, startUpdates, until } from "./state/updates";
import { clearStopMessage } from "./stop";

function show(part: preact.ComponentChild, id: string): void {
  const element = document.getElementById(id);
  if (element === null) throw new Error(`the page has no #${id}`);
  element.replaceChildren();
  render(part, element);
}

await applyLanguage();
show(
  <InLanguage>
    <Status />
  </InLanguage>,
  "status",
);
show(
  <InLanguage>
    <App />
  </InLanguage>,
  "app",
);
addEventListener("keydown", screenKeys);
// The outcome of the last stop is outdated when a person signs in, the arm works again or is connected, or a
// fault is acknowledged. The first answers about the cell outdate nothing: a stop that was sent before them may
// have ended the work that they tell of.
onceTrue(() => caller.value !== null, clearStopMessage);
startUpdates();
await until(loaded);
onceTrue(() => atWork.value || requesting.value || running.value !== null, clearStopMessage);
onceTrue(() => cell.value?.state === "ready", clearStopMessage);
onceTrue(() => cell.value?.state !== "fault", clearStopMessage);

/** Call `act` each time the condition changes from false to true. */
function onceTrue(condition: () => boolean, act: () => void): void {
  let before = true;
  effect(() => {
    const now = condition();
    if (now && !before) act();
    before = now;
  });
}
