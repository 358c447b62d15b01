/** The English text of the service below its translation, so that a person can quote it. */
export function Original({ shown, text }: { shown: string; text: string }) {
  if (shown.includes(text)) return null; // the same, or a part of the translation
  return (
    <small class="original" lang="en">
      {text}
    </small>
  );
}
