import { Fault } from "./bar/fault";
import { addressOf, go, route, SCREENS, type Screen } from "./route";
import { caller, signOut } from "./state/session";
import { Login } from "./login";
import { CalibrationScreen } from "./calibration/calibration";
import { HistoryScreen } from "./history/history";
import { ResultScreen } from "./result/result";
import { ScanScreen } from "./scan/scan";
import { useAction } from "./ui/action";
import { ManualLink, SECTIONS } from "./ui/manual";

const NAMES: Record<Screen, string> = { scan: "Scan", result: "Result", history: "History", calibration: "Calibration" };

/** All below the bar. */
export function App() {
  if (caller.value === undefined) return <main id="main">Asking the service ...</main>;
  if (caller.value === null) return <Login />;
  return (
    <>
      <nav aria-label="Screens">
        {SCREENS.map((screen, k) => (
          <a key={screen} href={addressOf(screen)} aria-current={route.value.screen === screen ? "page" : undefined}>
            <kbd aria-hidden="true">{k + 1}</kbd> {NAMES[screen]}
          </a>
        ))}
        <ManualLink page={SECTIONS[route.value.screen]} name="Help for this page">
          Help
        </ManualLink>
        <Who />
      </nav>
      <Fault />
      <main id="main" tabIndex={-1}>
        <CurrentScreen />
      </main>
    </>
  );
}

function CurrentScreen() {
  const { screen, id } = route.value;
  if (screen === "result") return <ResultScreen key={id} id={id} />;
  if (screen === "history") return <HistoryScreen key={id} id={id} />;
  if (screen === "calibration") return <CalibrationScreen />;
  return <ScanScreen />;
}

const MAY: Record<string, string> = {
  viewer: "viewer: looks, and can stop the arm",
  operator: "operator: scans",
  maintainer: "maintainer: may do everything",
};

function Who() {
  const action = useAction();
  const who = caller.value;
  if (!who) return null;
  if (who.local) return <p class="who">This machine: may do everything, there are no tokens</p>;
  return (
    <p class="who">
      {who.name}, {MAY[who.role]}{" "}
      <button type="button" class="plain" disabled={action.busy} onClick={() => void action.run(signOut)}>
        Sign out
      </button>
    </p>
  );
}

/** 1 to 4 change the screen, unless somebody writes. */
export function screenKeys(event: KeyboardEvent): void {
  const writing = event.target instanceof HTMLElement && event.target.matches("input, select, textarea");
  if (writing || event.ctrlKey || event.altKey || event.metaKey) return;
  const screen = SCREENS[Number(event.key) - 1];
  if (screen !== undefined) go(screen);
}
