import { WebGLRenderer } from "three";

/** The browser cannot draw in 3D. */
export class NoWebGLError extends Error {
  constructor() {
    super("the browser has no WebGL");
  }
}

/** Names of software renderers. */
const SLOW = /swiftshader|llvmpipe|software|basic render/i;
const SHARPEST = 2;

/** A renderer, and whether it draws without a graphics card. */
export interface Graphics {
  renderer: WebGLRenderer;
  isSlow: boolean;
}

/**
 * Open an antialiased renderer; with a graphics card it has the full resolution of the screen.
 *
 * @throws NoWebGLError
 */
export function openGraphics(canvas: HTMLCanvasElement): Graphics {
  // Requested here, because three.js would log an error of its own.
  const context = canvas.getContext("webgl2", { alpha: false, antialias: true, powerPreference: "high-performance" });
  if (context === null) throw new NoWebGLError();
  const renderer = new WebGLRenderer({ canvas, context });
  const named = context.getExtension("WEBGL_debug_renderer_info");
  const name = String(context.getParameter(named?.UNMASKED_RENDERER_WEBGL ?? context.RENDERER));
  const isSlow = SLOW.test(name);
  renderer.setPixelRatio(isSlow ? 1 : Math.min(devicePixelRatio, SHARPEST));
  return { renderer, isSlow };
}

/** Free the graphics memory; the canvas cannot be used again. */
export function closeGraphics(renderer: WebGLRenderer): void {
  renderer.dispose();
  renderer.getContext().getExtension("WEBGL_lose_context")?.loseContext();
}
