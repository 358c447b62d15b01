import type { ComponentType } from "preact";
import { useEffect, useState } from "preact/hooks";
import { SCREENS, type Screen } from "./route";
import { t } from "./texts/translate";
import { loadCode } from "./ui/on_demand";

/** A screen; `id` is the scan in its address. */
type ScreenComponent = ComponentType<{ id: string | null }>;

/** Loads the code of each screen, which is not part of the first load of the page. */
const LOADERS: Record<Screen, () => Promise<ScreenComponent>> = {
  scan: async () => (await import("./scan/scan")).ScanScreen,
  result: async () => (await import("./result/result")).ResultScreen,
  history: async () => (await import("./history/history")).HistoryScreen,
  calibration: async () => (await import("./calibration/calibration")).CalibrationScreen,
};
const loaded = new Map<Screen, ScreenComponent>();

async function load(screen: Screen): Promise<void> {
  loaded.set(screen, await loadCode(LOADERS[screen]));
}

/** A screen, as soon as its code is loaded. The other screens are loaded next, so that they open without the service. */
export function LoadedScreen({ screen, id }: { screen: Screen; id: string | null }) {
  const [, setShown] = useState<Screen | null>(null);
  useEffect(() => {
    void load(screen).then(() => {
      setShown(screen);
      for (const other of SCREENS) if (!loaded.has(other)) void load(other);
    });
  }, [screen]);
  const Component = loaded.get(screen);
  return Component === undefined ? <p>{t("app.waiting")}</p> : <Component id={id} />;
}
