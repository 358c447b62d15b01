const FILE_FIRST = /^\S+\.\w/;

/** The service's words as a sentence: a file's name stays as it is, and the backticks of commands go. */
export function sentence(words: string): string {
  const first = FILE_FIRST.test(words) ? words.charAt(0) : words.charAt(0).toUpperCase();
  const begun = first + words.slice(1).replaceAll("`", "");
  return /[.!?]$/.test(begun) ? begun : `${begun}.`;
}
