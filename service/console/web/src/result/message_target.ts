import type { Target } from "../view3d/scene";

const POINT = /\((-?\d+), (-?\d+), (-?\d+)\) mm/;
const NUMBERED = /\b(crossing|chain|view) (\d+)/;

/** Return what a message of the service is about; null: nothing that can be shown. */
export function targetInMessage(message: string): Target | null {
  const [, kind, number] = NUMBERED.exec(message) ?? [];
  if (kind === "crossing") return { kind, id: Number(number) };
  const point = POINT.exec(message);
  if (point !== null) {
    const [x = 0, y = 0, z = 0] = point.slice(1).map((mm) => Number(mm) / 1000);
    return { kind: "at", point: [x, y, z] };
  }
  if (kind === "chain") return { kind, id: Number(number) };
  return kind === "view" ? { kind, index: Number(number) } : null;
}
