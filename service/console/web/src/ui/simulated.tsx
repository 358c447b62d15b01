import type { Cell, Scan } from "../net/api";
import { t } from "../texts/translate";

/** A mark for what is simulated. It must not be mistaken for the real cell, nor the real arm for a simulated one. */
export function Simulated({ children }: { children: string }) {
  return <strong class="simulated">{children}</strong>;
}

/** Marks a simulated cell. A cell of which only one device is simulated names the real one. */
export function SimulatedCell({ cell }: { cell: Cell }) {
  if (!cell.simulated) return null;
  const arm = cell.robot.kind === "simulated";
  const camera = cell.camera.kind === "simulated";
  if (arm && camera) return <Simulated>{t("simulated.both")}</Simulated>;
  return <Simulated>{arm ? t("simulated.arm") : t("simulated.camera")}</Simulated>;
}

/** Marks the scan of a simulated cell. */
export function SimulatedMark({ scan }: { scan: Scan }) {
  return scan.simulated === true ? <Simulated>{t("simulated.both")}</Simulated> : null;
}
