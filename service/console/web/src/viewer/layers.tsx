import type { Layer } from "../view3d/view3d";

const NAMES: [Layer, string][] = [
  ["strings", "Strings"],
  ["cloud", "Measured points"],
  ["crossings", "Crossings"],
  ["grasps", "Grasps"],
  ["cameras", "Cameras"],
  ["arm", "Arm"],
  ["labels", "Labels"],
  ["room", "Table"],
];

interface LayersProps {
  /** What there is something of. */
  there: ReadonlySet<Layer>;
  shown: ReadonlySet<Layer>;
  set: (shown: ReadonlySet<Layer>) => void;
}

/** Switches what is drawn. */
export function Layers({ there, shown, set }: LayersProps) {
  const toggle = (layer: Layer) => set(new Set(shown.has(layer) ? [...shown].filter((one) => one !== layer) : [...shown, layer]));
  return (
    <fieldset class="row layers">
      <legend class="small">Show</legend>
      {NAMES.filter(([layer]) => there.has(layer)).map(([layer, name]) => (
        <label key={layer} class="tick">
          <input type="checkbox" checked={shown.has(layer)} onChange={() => toggle(layer)} />
          {name}
        </label>
      ))}
    </fieldset>
  );
}
