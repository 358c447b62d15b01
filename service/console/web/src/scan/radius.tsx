import { room } from "../state/room";
import { NumberField } from "../ui/number_field";
import { readNumber, type Reading } from "../words/number";

/** The string radius that somebody has written in mm, as far as the service takes it. */
export function readRadius(text: string): Reading {
  const [min, max] = room.value?.scan.string_radius_range_m ?? [0, Infinity];
  return readNumber(text, { min: inMm(min), max: inMm(max), unit: "mm" });
}

/** A radius in metres; null: none was written. */
export function radiusOf({ value }: Reading): number | null {
  return value === null ? null : value / 1000;
}

/** A radius as it would be written. */
export function radiusText(radius_m: number | null): string {
  return radius_m === null ? "" : String(inMm(radius_m));
}

function inMm(metres: number): number {
  return Number((metres * 1000).toFixed(3));
}

interface RadiusFieldProps {
  reading: Reading;
  write: (text: string) => void;
  empty: string;
}

/** Asks for the string's radius. */
export function RadiusField(props: RadiusFieldProps) {
  return <NumberField label="String radius, in mm" hint="string radius" {...props} />;
}
