/** Identifies requests of the console: over plain HTTP, other pages cannot send this header. */
export const CONSOLE_HEADERS = { "X-Pointchain": "console" };
