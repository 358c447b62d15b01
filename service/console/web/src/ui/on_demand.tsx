import type { ComponentType } from "preact";
import { useEffect, useState } from "preact/hooks";

/** Pause before code that did not arrive is requested again. */
const RETRY_MS = 1000;

/** Load code, again and again until the service answers, as the bar says. */
export async function loadCode<T>(load: () => Promise<T>): Promise<T> {
  for (;;) {
    try {
      return await load();
    } catch {
      await new Promise((resolve) => setTimeout(resolve, RETRY_MS));
    }
  }
}

/** Return a component whose code is loaded when it is first shown. Until then nothing is shown. */
export function onDemand<P extends object>(load: () => Promise<ComponentType<P>>): ComponentType<P> {
  let loaded: ComponentType<P> | null = null;
  return function OnDemand(props: P) {
    const [, setShown] = useState(loaded);
    useEffect(() => {
      if (loaded !== null) return;
      void loadCode(load).then((component) => {
        loaded = component;
        setShown(() => component);
      });
    }, []);
    const Component = loaded;
    return Component === null ? null : <Component {...props} />;
  };
}
