const [SHORTEST, LONGEST] = [60, 160];
const ROUND_MM = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000];

/** A bar in the corner that says how large things are where the view turns about. */
export class Scale {
  private readonly element = document.createElement("div");
  private readonly bar = document.createElement("span");
  private readonly words = document.createElement("span");

  constructor(parent: HTMLElement) {
    this.element.className = "scale3d";
    this.element.append(this.words, this.bar);
    parent.append(this.element);
  }

  /** So many pixels are a metre now. */
  update(pixelsPerMetre: number): void {
    const widths = ROUND_MM.map((mm) => ({ mm, pixels: (mm / 1000) * pixelsPerMetre }));
    const fits = widths.find(({ pixels }) => pixels >= SHORTEST && pixels <= LONGEST);
    this.bar.style.width = `${fits?.pixels ?? 0}px`;
    this.words.textContent = fits ? `${fits.mm} mm` : "";
  }

  dispose(): void {
    this.element.remove();
  }
}
