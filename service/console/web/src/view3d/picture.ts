type Paint = CanvasRenderingContext2D;

/** Pattern of a dashed border, pixels. */
const DASHES = [4, 3];
/** Height of a line of the caption, and its margin, pixels of the page. */
const [LINE, MARGIN] = [20, 8];

/** What a picture shows, for people who see it without the page. */
export interface Caption {
  /** A mark that must not be missed, such as that of a simulated cell; null: none. */
  mark: string | null;
  lines: readonly string[];
}

/**
 * Return the drawn canvas with its labels as a PNG. Call it directly after a frame was drawn: later, the browser may
 * have cleared the canvas.
 *
 * @param labels Element with the labels and the scale above the canvas.
 * @param caption Written below the picture.
 */
export function pictureOf(canvas: HTMLCanvasElement, labels: HTMLElement, caption: Caption): Promise<Blob> {
  const picture = document.createElement("canvas");
  const sharpness = canvas.width / canvas.getBoundingClientRect().width;
  const strip = Math.ceil(sharpness * (caption.lines.length * LINE + 2 * MARGIN));
  [picture.width, picture.height] = [canvas.width, canvas.height + strip];
  const paint = picture.getContext("2d");
  if (paint === null) throw new Error("the browser has no 2D canvas");
  paint.drawImage(canvas, 0, 0);
  const area = canvas.getBoundingClientRect();
  paint.scale(canvas.width / area.width, canvas.height / area.height);
  paint.translate(-area.left, -area.top);
  for (const box of labels.querySelectorAll<HTMLElement>(".label3d, .scale3d span")) paintBox(paint, box);
  paint.setTransform(sharpness, 0, 0, sharpness, 0, canvas.height);
  paintCaption(paint, caption, area.width);
  return new Promise((resolve, reject) => {
    picture.toBlob((blob) => (blob === null ? reject(new Error("the picture is empty")) : resolve(blob)));
  });
}

/** Paint the caption from the origin down. */
function paintCaption(paint: Paint, { mark, lines }: Caption, width: number): void {
  const colour = (name: string) => getComputedStyle(document.documentElement).getPropertyValue(name);
  paint.fillStyle = colour("--panel");
  paint.fillRect(0, 0, width, lines.length * LINE + 2 * MARGIN);
  paint.textBaseline = "middle";
  let left = MARGIN;
  if (mark !== null) {
    paint.font = `bold 13px ${getComputedStyle(document.body).fontFamily}`;
    const wide = paint.measureText(mark).width + MARGIN;
    paint.fillStyle = colour("--simulated");
    paint.fillRect(left, MARGIN, wide, LINE - 2);
    paint.fillStyle = "#111";
    paint.fillText(mark, left + MARGIN / 2, MARGIN + LINE / 2 - 1);
    left += wide + MARGIN;
  }
  paint.font = `13px ${getComputedStyle(document.body).fontFamily}`;
  paint.fillStyle = colour("--ink");
  lines.forEach((line, index) => paint.fillText(line, index === 0 ? left : MARGIN, MARGIN + (index + 0.5) * LINE - 1));
}

/** Paint the background, the border and the texts of an element, if it is visible. */
function paintBox(paint: Paint, box: HTMLElement): void {
  const style = getComputedStyle(box);
  if (box.getClientRects().length === 0 || style.visibility !== "visible") return;
  const { left, top, width, height } = box.getBoundingClientRect();
  paint.beginPath();
  paint.roundRect(left, top, width, height, Math.min(Number.parseFloat(style.borderTopLeftRadius) || 0, height / 2));
  paint.fillStyle = style.backgroundColor;
  paint.fill();
  paint.lineWidth = Number.parseFloat(style.borderBottomWidth);
  if (paint.lineWidth > 0 && style.borderBottomStyle !== "none") {
    paint.strokeStyle = style.borderBottomColor;
    paint.setLineDash(style.borderBottomStyle === "dashed" ? DASHES : []);
    if (style.borderTopStyle === "none" || Number.parseFloat(style.borderTopWidth) === 0) openAtTop(paint, box);
    paint.stroke();
  }
  const texts = document.createTreeWalker(box, NodeFilter.SHOW_TEXT);
  while (texts.nextNode()) paintText(paint, texts.currentNode);
}

/** Begin a path along the left, lower and right side of an element, as the scale has it. */
function openAtTop(paint: Paint, box: HTMLElement): void {
  const { left, right, top, bottom } = box.getBoundingClientRect();
  paint.beginPath();
  paint.moveTo(left, top);
  paint.lineTo(left, bottom);
  paint.lineTo(right, bottom);
  paint.lineTo(right, top);
}

function paintText(paint: Paint, text: Node): void {
  const range = document.createRange();
  range.selectNodeContents(text);
  if (text.parentElement === null || range.getClientRects().length === 0) return;
  const { left, top, height } = range.getBoundingClientRect();
  const { color, fontWeight, fontSize, fontFamily } = getComputedStyle(text.parentElement);
  paint.fillStyle = color;
  paint.font = `${fontWeight} ${fontSize} ${fontFamily}`;
  paint.textBaseline = "middle";
  paint.fillText(text.textContent ?? "", left, top + height / 2);
}
