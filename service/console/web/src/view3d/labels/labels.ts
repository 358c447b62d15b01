import { type Object3D, type Scene, Vector3 } from "three";
import { CSS2DObject, CSS2DRenderer } from "three/examples/jsm/renderers/CSS2DRenderer.js";
import { inside, movedInside, overlap, rectangleBeside, type Rectangle } from "./rectangle";
import type { Target, Point } from "../scene";
import { pixelsAhead, type Screen, project } from "../camera/screen";

/** The texts of a label and its target. */
export interface LabelText {
  /** Always shown. */
  brief: string;
  /** Shown where there is room. */
  detail?: string;
  /** Style classes. */
  kind: string;
  /** The target that a tap selects. */
  target?: Target;
  /** Labels of a lower rank are placed first. From rank 1 on, a label without room is hidden; below 0 it is shown in full. */
  rank: number;
  /** Radius of the body beside the label, metres. */
  around_m?: number;
}

interface LabelData {
  target: Target | null;
  rank: number;
  around_m: number;
  size: { brief: [number, number]; full: [number, number] } | null;
}

const DATA = new WeakMap<CSS2DObject, LabelData>();

/** Create a label that is placed beside a point. */
export function label(text: LabelText, point: Point | Vector3): CSS2DObject {
  const element = document.createElement("span");
  element.className = `label3d ${text.kind}`;
  element.append(strong(text.brief));
  if (text.detail !== undefined) element.append(small(text.detail));
  const object = new CSS2DObject(element);
  object.position.copy(point instanceof Vector3 ? point : new Vector3().fromArray(point));
  DATA.set(object, { target: text.target ?? null, rank: text.rank, around_m: text.around_m ?? 0, size: null });
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
  private taken: { area: Rectangle; target: Target | null; rank: number }[] = [];

  constructor(private readonly element: HTMLElement) {
    this.renderer = new CSS2DRenderer({ element });
    element.classList.add("labels3d");
    element.setAttribute("aria-hidden", "true"); // the lists of the page contain the same texts
  }

  setSize(width: number, height: number): void {
    this.renderer.setSize(width, height);
  }

  /** Show or hide the labels; the scale stays. */
  show(shown: boolean): void {
    this.element.classList.toggle("quiet", !shown);
  }

  /** Place the labels; none covers the area `kept`. */
  draw(scene: Scene, screen: Screen, strings: readonly Rectangle[], kept: Rectangle): void {
    this.taken = [{ area: kept, target: null, rank: -1 }];
    if (this.element.classList.contains("quiet")) return;
    const objects = labelsIn(scene);
    if (objects.some((object) => dataOf(object).size === null)) {
      this.renderer.render(scene, screen.camera); // adds them to the page, where they get a size
      objects.forEach(measure);
    }
    objects.sort((a, b) => dataOf(a).rank - dataOf(b).rank);
    for (const object of objects) this.arrange(object, screen, strings);
    this.renderer.render(scene, screen.camera);
  }

  /** Return the target of the label at a point of the canvas. */
  placeAt(x: number, y: number): Target | null {
    const finger = { left: x - 6, right: x + 6, top: y - 6, bottom: y + 6 };
    return this.taken.find(({ area, target }) => target !== null && overlap(area, finger))?.target ?? null;
  }

  /** Place a label in full where it covers nothing, else in brief, else over strings, else hide it. */
  private arrange(object: CSS2DObject, screen: Screen, strings: readonly Rectangle[]): void {
    const { rank, size, target, around_m } = dataOf(object);
    const projected = project(object.getWorldPosition(new Vector3()), screen);
    if (size === null || projected.ahead_m <= 0) return;
    const off = OFF + (around_m * pixelsAhead(screen)) / projected.ahead_m;
    const free = (area: Rectangle) => inside(area, screen) && !this.taken.some((other) => overlap(other.area, area));
    const clear = (area: Rectangle) => free(area) && !strings.some((one) => overlap(one, area));
    const [full, brief] = [size.full, size.brief].map((one) =>
      WAYS.map((way) => rectangleBeside(projected, one, way, off)),
    );
    const marked = this.taken.filter((other) => other.rank < 0);
    const always = (area: Rectangle) => rank < 1 && !marked.some((other) => overlap(other.area, area));
    const short = rank < 0 ? full : brief;
    const isOnScreen = inside({ left: projected.x, right: projected.x, top: projected.y, bottom: projected.y }, screen);
    const shown = isOnScreen ? short?.map((one) => movedInside(one, screen)) : [];
    const area = full?.find(clear) ?? short?.find(clear) ?? short?.find(free) ?? shown?.find(always);
    object.element.classList.toggle("brief", area !== undefined && short !== full && !full?.includes(area));
    object.element.classList.toggle("crowded", area === undefined);
    if (area === undefined) return;
    object.center.set((projected.x - area.left) / (area.right - area.left), (projected.y - area.top) / (area.bottom - area.top));
    this.taken.push({ area, target, rank });
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
  return DATA.get(object) ?? { target: null, rank: Infinity, around_m: 0, size: null };
}

/** Store the size of a label once it is in the page. */
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
