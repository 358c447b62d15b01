/** Size of a page pixel at a distance of one metre, metres. The stage sets it, and the shaders read it. */
export const PIXEL = { value: 0.001 };

/** Number of screen pixels per page pixel, likewise. */
export const SHARPNESS = { value: 1 };
