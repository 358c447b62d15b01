import { type Object3D, type Scene, Vector3 } from "three";
import { CSS2DObject, CSS2DRenderer } from "three/examples/jsm/renderers/CSS2DRenderer.js";
import { besides, inside, overlap, type Rectangle } from "./rectangle";
import type { Place, Point } from "./scene";
import { pixelsAhead, type Screen, seenAt } from "./screen";

/** What a label says, and what it is for. */
export interface LabelText {
  /** Always shown. */
  brief: string;
  /** Shown where there is room. */
  detail?: string;
  /** For the style sheet: one or more words. */
  kind: string;
  /** What a tap on it picks. */
  place?: Place;
  /** The lower, the sooner it is placed. What finds no room is left out from 1 on; below 0 all of it is shown. */
  rank: number;
  /** Radius of the body that it stands at. */
  around_m?: number;
}

interface LabelData {
  place: Place | null;
  rank: number;
  around_m: number;
  size: { brief: [number, number]; full: [number, number] } | null;
}

const DATA = new WeakMap<CSS2DObject, LabelData>();

/** A label at a point, beside which it finds its place. */
export function label(text: LabelText, point: Point | Vector3): CSS2DObject {
  const element = document.createElement("span");
  element.className = `label3d ${text.kind}`;
  element.append(strong(text.brief));
  if (text.detail !== undefined) element.append(small(text.detail));
  const object = new CSS2DObject(element);
  object.position.copy(point instanceof Vector3 ? point : new Vector3().fromArray(point));
  DATA.set(object, { place: text.place ?? null, rank: text.rank, around_m: text.around_m ?? 0, size: null });
  return object;
}

function strong(text: string): HTMLElement {
  const element = document.createElement("b");
  element.textContent = text;
  return element;
}

function small(text: string): HTMLElement {
  const element = document.createElement("small");
  element.textContent = text;
  return element;
}

/** Ways in which a label may stand off its point: above it first. */
const WAYS = [
  [0, -1],
  [1, 0],
  [-1, 0],
  [0, 1],
] as const;
/** From its point's body, pixels. */
const OFF = 5;

/** Puts the labels of a scene over the canvas, so that they cover neither one another nor, if long, the strings. */
export class LabelLayer {
  private readonly renderer: CSS2DRenderer;
  private taken: { area: Rectangle; place: Place | null; rank: number }[] = [];

  constructor(private readonly element: HTMLElement) {
    this.renderer = new CSS2DRenderer({ element });
    element.classList.add("labels3d");
    element.setAttribute("aria-hidden", "true"); // the page's lists say all of it
  }

  setSize(width: number, height: number): void {
    this.renderer.setSize(width, height);
  }

  /** Without labels the scale stays. */
  show(shown: boolean): void {
    this.element.classList.toggle("quiet", !shown);
  }

  draw(scene: Scene, screen: Screen, strings: readonly Rectangle[]): void {
    this.taken = [];
    if (this.element.classList.contains("quiet")) return;
    const objects = labelsIn(scene);
    if (objects.some((object) => dataOf(object).size === null)) {
      this.renderer.render(scene, screen.camera); // puts them into the page, where they have a size
      objects.forEach(measure);
    }
    objects.sort((a, b) => dataOf(a).rank - dataOf(b).rank);
    for (const object of objects) this.arrange(object, screen, strings);
    this.renderer.render(scene, screen.camera);
  }

  /** What the label at a point of the canvas stands for. */
  placeAt(x: number, y: number): Place | null {
    const finger = { left: x - 6, right: x + 6, top: y - 6, bottom: y + 6 };
    return this.taken.find(({ area, place }) => place !== null && overlap(area, finger))?.place ?? null;
  }

  /** In full where that covers nothing, else in brief, else over strings, else not at all. */
  private arrange(object: CSS2DObject, screen: Screen, strings: readonly Rectangle[]): void {
    const { rank, size, place, around_m } = dataOf(object);
    const seen = seenAt(object.getWorldPosition(new Vector3()), screen);
    if (size === null || seen.ahead_m <= 0) return;
    const off = OFF + (around_m * pixelsAhead(screen)) / seen.ahead_m;
    const free = (area: Rectangle) => inside(area, screen) && !this.taken.some((other) => overlap(other.area, area));
    const clear = (area: Rectangle) => free(area) && !strings.some((one) => overlap(one, area));
    const [full, brief] = [size.full, size.brief].map((one) => WAYS.map((way) => besides(seen, one, way, off)));
    const marked = this.taken.filter((other) => other.rank < 0);
    const always = (area: Rectangle) => rank < 1 && !marked.some((other) => overlap(other.area, area));
    const short = rank < 0 ? full : brief;
    const area = full?.find(clear) ?? short?.find(clear) ?? short?.find(free) ?? short?.find(always);
    object.element.classList.toggle("brief", area !== undefined && !full?.includes(area));
    object.element.classList.toggle("crowded", area === undefined);
    if (area === undefined) return;
    object.center.set((seen.x - area.left) / (area.right - area.left), (seen.y - area.top) / (area.bottom - area.top));
    this.taken.push({ area, place, rank });
  }
}

function labelsIn(scene: Object3D): CSS2DObject[] {
  const found: CSS2DObject[] = [];
  scene.traverseVisible((object) => {
    if (object instanceof CSS2DObject) found.push(object);
  });
  return found;
}

function dataOf(object: CSS2DObject): LabelData {
  return DATA.get(object) ?? { place: null, rank: Infinity, around_m: 0, size: null };
}

/** Notes a label's size, once it is in the page. */
function measure(object: CSS2DObject): void {
  const { element } = object;
  const data = dataOf(object);
  if (data.size !== null || !element.isConnected || element.style.display === "none") return;
  const sizeAs = (brief: boolean): [number, number] => {
    element.classList.toggle("brief", brief);
    return [element.offsetWidth, element.offsetHeight];
  };
  data.size = { brief: sizeAs(true), full: sizeAs(false) };
}
