/** Over plain HTTP, browsers do not say which page asks: this header does, for no other page can send it. */
export const OURS = { "X-Pointchain": "console" };
