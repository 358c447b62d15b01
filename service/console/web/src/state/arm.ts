import { computed, signal } from "@preact/signals";
import { cell } from "./cell";
import { lost } from "./freshness";
import { live } from "./live";

/** The posture of the arm, as an event has it. */
export interface ArmPosture {
  q_rad: readonly number[] | null;
  moving: boolean | null;
}

/** The last event of the arm; null: none came, so the slower state of the cell counts. */
export const armEvent = signal<ArmPosture | null>(null);

/** Last known joint angles of the arm; null: unknown. */
export const joints_rad = computed(() => {
  if (lost.value) return null;
  return (live.value ? armEvent.value?.q_rad : null) ?? cell.value?.robot.q_rad ?? null;
});
