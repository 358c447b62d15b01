import type { ComponentType } from "preact";
import { useEffect } from "preact/hooks";
import { SCREENS, type Screen } from "./route";
import { t } from "./texts/translate";
import { onDemand, type OnDemand } from "./ui/on_demand";

interface ScreenProps {
  /** ID of the scan in the address. */
  id: string | null;
}

function screenOf(load: () => Promise<ComponentType<ScreenProps>>): OnDemand<ScreenProps> {
  return onDemand(load, () => <p>{t("app.waiting")}</p>);
}

/** The screens. Their code is not part of the first load of the page. */
const BY_NAME: Record<Screen, OnDemand<ScreenProps>> = {
  scan: screenOf(async () => (await import("./scan/scan")).ScanScreen),
  result: screenOf(async () => (await import("./result/result")).ResultScreen),
  history: screenOf(async () => (await import("./history/history")).HistoryScreen),
  calibration: screenOf(async () => (await import("./calibration/calibration")).CalibrationScreen),
};

/** A screen, as soon as its code is loaded. The other screens are loaded next, so that they open without the service. */
export function LoadedScreen({ screen, id }: { screen: Screen; id: string | null }) {
  const { Component, preload } = BY_NAME[screen];
  useEffect(() => {
    void preload().then(() => SCREENS.forEach((other) => void BY_NAME[other].preload()));
  }, [screen]);
  return <Component id={id} />;
}
