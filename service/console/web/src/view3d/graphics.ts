import { WebGLRenderer } from "three";

/** The browser cannot draw in 3D. */
export class NoWebGLError extends Error {
  constructor() {
    super("This browser cannot draw in 3D (it has no WebGL).");
  }
}

/** Names of what draws without a graphics card. */
const SLOW = /swiftshader|llvmpipe|software|basic render/i;
const SHARPEST = 2;

/**
 * Draws on a canvas, smoothly; as sharp as the screen is where a graphics card does the work.
 *
 * @throws NoWebGLError
 */
export function openGraphics(canvas: HTMLCanvasElement): WebGLRenderer {
  // Asked for here and not by three, which would write an error of its own.
  const context = canvas.getContext("webgl2", { alpha: false, antialias: true, powerPreference: "high-performance" });
  if (context === null) throw new NoWebGLError();
  const renderer = new WebGLRenderer({ canvas, context });
  const named = context.getExtension("WEBGL_debug_renderer_info");
  const name = String(context.getParameter(named?.UNMASKED_RENDERER_WEBGL ?? context.RENDERER));
  renderer.setPixelRatio(SLOW.test(name) ? 1 : Math.min(devicePixelRatio, SHARPEST));
  return renderer;
}

/** Gives the graphics' memory back; the canvas cannot be used again. */
export function closeGraphics(renderer: WebGLRenderer): void {
  renderer.dispose();
  renderer.getContext().getExtension("WEBGL_lose_context")?.loseContext();
}
