import { t } from "../../texts/translate";
import type { Rectangle } from "./rectangle";

const [SHORTEST, LONGEST] = [60, 160];
const ROUND_MM = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000];

/** A scale bar in the corner, for the centre of the view. */
export class Scale {
  private readonly element = document.createElement("div");
  private readonly bar = document.createElement("span");
  private readonly text = document.createElement("span");

  constructor(parent: HTMLElement) {
    this.element.className = "scale3d";
    this.element.append(this.text, this.bar);
    parent.append(this.element);
  }

  /** Update the bar for a number of pixels per metre. */
  update(pixelsPerMetre: number): void {
    const widths = ROUND_MM.map((mm) => ({ mm, pixels: (mm / 1000) * pixelsPerMetre }));
    const fits = widths.find(({ pixels }) => pixels >= SHORTEST && pixels <= LONGEST);
    this.bar.style.width = `${fits?.pixels ?? 0}px`;
    this.text.textContent = fits ? t("units.mm", { value: fits.mm }) : "";
  }

  /** The part of the canvas that the bar covers. */
  get area(): Rectangle {
    const { offsetLeft: left, offsetTop: top, offsetWidth, offsetHeight } = this.element;
    return { left, top, right: left + offsetWidth, bottom: top + offsetHeight };
  }

  dispose(): void {
    this.element.remove();
  }
}
