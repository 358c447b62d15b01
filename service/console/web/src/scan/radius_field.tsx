import { geometry } from "../state/geometry";
import { shown, t } from "../texts/translate";
import { NumberField } from "../ui/number_field";
import { parseNumber, type ParsedNumber } from "../ui/parse_number";

/** Parse a string radius in mm, in the range that the service accepts. */
export function parseRadius(text: string): ParsedNumber {
  const [min, max] = geometry.value?.scan.string_radius_range_m ?? [0, Infinity];
  return parseNumber(text, { min: millimetres(min), max: millimetres(max), unit: t("units.millimetres") });
}

/** Return a radius in metres; null: none was entered. */
export function radiusMetres({ value }: ParsedNumber): number | null {
  return value === null ? null : value / 1000;
}

/** Return a radius as a person would enter it. */
export function radiusText(radius_m: number | null): string {
  return radius_m === null ? "" : shown(millimetres(radius_m));
}

function millimetres(metres: number): number {
  return Number((metres * 1000).toFixed(3));
}

interface RadiusFieldProps {
  number: ParsedNumber;
  write: (text: string) => void;
  empty: string;
}

/** The input for the string radius. */
export function RadiusField(props: RadiusFieldProps) {
  return <NumberField label={t("field.radius")} hint="string_radius" {...props} />;
}
