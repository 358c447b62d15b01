/** Size of a pixel of the page at a distance of one metre, metres: read by the shaders, kept by whoever draws. */
export const PIXEL = { value: 0.001 };

/** How many of the screen's pixels a pixel of the page has, likewise. */
export const SHARPNESS = { value: 1 };
