import { Color } from "three";
import { ORDER_STOPS } from "./strings/order_colours";

/** Colour scheme of the page. */
export type Scheme = "light" | "dark";

/** The scene's colours. */
export interface Palette {
  ground: Color;
  ink: Color;
  muted: Color;
  line: Color;
  /** The table in the height map. */
  table: Color;
  /** The selected target. */
  accent: Color;
  /** An unobserved end. */
  warn: Color;
  unsure: Color;
  grasp: Color;
  measured: Color;
  arm: Color;
  cloudLow: Color;
  cloudHigh: Color;
}

/** Custom properties of the page, with defaults. */
const OF_THE_PAGE = {
  ground: ["--ground", "#ffffff", "#0d1216"],
  ink: ["--ink", "#10181f", "#eff4f7"],
  muted: ["--muted", "#44515c", "#b9c5ce"],
  line: ["--line", "#b9c3cb", "#37434d"],
  table: ["--table", "#d3dce3", "#2c3842"],
  accent: ["--accent", "#0a4a94", "#9ccaff"],
  warn: ["--warn", "#7a4600", "#ffcb70"],
} as const;
/** Colours that only the scene has. */
const OWN: Record<Scheme, Record<Exclude<keyof Palette, keyof typeof OF_THE_PAGE>, string>> = {
  light: { unsure: "#d83a00", grasp: "#b0008e", measured: "#c2410c", arm: "#5b6770", cloudLow: "#3c464e", cloudHigh: "#a9b4bc" },
  dark: { unsure: "#ff7a45", grasp: "#ff6ad5", measured: "#ffd166", arm: "#9fb0bc", cloudLow: "#5d6972", cloudHigh: "#d5dee4" },
};

/** Return the colours of a scheme; shared ones come from the style of the page. */
export function paletteOf(element: Element, scheme: Scheme): Palette {
  const style = getComputedStyle(element);
  const page = (name: keyof typeof OF_THE_PAGE) => {
    const [property, light, dark] = OF_THE_PAGE[name];
    return new Color(style.getPropertyValue(property).trim() || (scheme === "dark" ? dark : light));
  };
  const own = OWN[scheme];
  return {
    ground: page("ground"),
    ink: page("ink"),
    muted: page("muted"),
    line: page("line"),
    table: page("table"),
    accent: page("accent"),
    warn: page("warn"),
    unsure: new Color(own.unsure),
    grasp: new Color(own.grasp),
    measured: new Color(own.measured),
    arm: new Color(own.arm),
    cloudLow: new Color(own.cloudLow),
    cloudHigh: new Color(own.cloudHigh),
  };
}

const STOPS = ORDER_STOPS.map((stop) => new Color(stop));

/** Return the colour of a string at a fraction of its length. */
export function orderColour(share: number): Color {
  const at = Math.min(Math.max(share, 0), 1) * (STOPS.length - 1);
  const from = Math.min(Math.floor(at), STOPS.length - 2);
  return new Color().lerpColors(STOPS[from] ?? new Color(), STOPS[from + 1] ?? new Color(), at - from);
}
