/** The service's words as a sentence; commands are in backticks there. */
export function sentence(words: string): string {
  const begun = words.charAt(0).toUpperCase() + words.slice(1).replaceAll("`", "");
  return /[.!?]$/.test(begun) ? begun : `${begun}.`;
}
