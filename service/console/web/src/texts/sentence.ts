const FILE_FIRST = /^\S+\.\w/;

/** Return a text of the service as a sentence: a leading file name stays as it is, and backticks are removed. */
export function sentence(text: string): string {
  const first = FILE_FIRST.test(text) ? text.charAt(0) : text.charAt(0).toUpperCase();
  const begun = first + text.slice(1).replaceAll("`", "");
  if (/[.!?。]$/.test(begun)) return begun;
  return /[\u3040-\u9fff]$/.test(begun) ? `${begun}。` : `${begun}.`;
}
