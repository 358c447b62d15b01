import type { ComponentChildren, ComponentType } from "preact";
import { useEffect, useState } from "preact/hooks";

/** Pause before code that did not arrive is requested again. */
const RETRY_MS = 1000;

/** A component whose code is loaded when it is first shown, or before by `preload`. */
export interface OnDemand<P> {
  Component: ComponentType<P>;
  preload(): Promise<void>;
}

/** Return a component whose code is loaded on demand. Until it is there, `waiting` is shown. */
export function onDemand<P extends object>(
  load: () => Promise<ComponentType<P>>,
  waiting: () => ComponentChildren = () => null,
): OnDemand<P> {
  let Loaded: ComponentType<P> | null = null;
  let loading: Promise<void> | null = null;

  async function request(): Promise<void> {
    while (Loaded === null) {
      try {
        Loaded = await load();
      } catch {
        // The service did not answer, as the bar says.
        await new Promise((resolve) => setTimeout(resolve, RETRY_MS));
      }
    }
  }

  const preload = () => (loading ??= request());

  function Component(props: P) {
    const [, setReady] = useState(Loaded !== null);
    useEffect(() => {
      void preload().then(() => setReady(true));
    }, []);
    return Loaded === null ? <>{waiting()}</> : <Loaded {...props} />;
  }
  return { Component, preload };
}
