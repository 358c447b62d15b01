import { t } from "../texts/translate";
import type { Layer } from "../view3d/view3d";

const LAYERS: readonly Layer[] = ["strings", "cloud", "crossings", "grasps", "cameras", "arm", "labels", "geometry", "heights"];

interface LayersProps {
  /** The layers that have content. */
  available: ReadonlySet<Layer>;
  shown: ReadonlySet<Layer>;
  set: (shown: ReadonlySet<Layer>) => void;
}

/** The switches of what is drawn. */
export function Layers({ available, shown, set }: LayersProps) {
  const toggle = (layer: Layer) => set(new Set(shown.has(layer) ? [...shown].filter((one) => one !== layer) : [...shown, layer]));
  return (
    <fieldset class="row layers">
      <legend class="small">{t("viewer.layers")}</legend>
      {LAYERS.filter((layer) => available.has(layer)).map((layer) => (
        <label key={layer} class="tick">
          <input type="checkbox" checked={shown.has(layer)} onChange={() => toggle(layer)} />
          {t(`viewer.layer.${layer}`)}
        </label>
      ))}
    </fieldset>
  );
}
