import { signal } from "@preact/signals";

/** As in console.css. */
const query = matchMedia("(max-width: 40rem), (max-height: 30rem)");

/** Whether the page is as narrow, or as low, as on a phone. */
export const narrow = signal(query.matches);
query.addEventListener("change", () => (narrow.value = query.matches));
