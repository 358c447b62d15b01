import type { Place } from "../view3d/scene";

const POINT = /\((-?\d+), (-?\d+), (-?\d+)\) mm/;
const NUMBERED = /\b(crossing|chain|view) (\d+)/;

/** Which place the service's words are about, a warning's; null: none that can be shown. */
export function placeIn(words: string): Place | null {
  const [, kind, number] = NUMBERED.exec(words) ?? [];
  if (kind === "crossing") return { kind, id: Number(number) };
  const point = POINT.exec(words);
  if (point !== null) {
    const [x = 0, y = 0, z = 0] = point.slice(1).map((mm) => Number(mm) / 1000);
    return { kind: "at", point: [x, y, z] };
  }
  if (kind === "chain") return { kind, id: Number(number) };
  return kind === "view" ? { kind, index: Number(number) } : null;
}
