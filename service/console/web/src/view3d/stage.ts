import { AmbientLight, Scene, type Vector3, type WebGLRenderer } from "three";
import { drawArm, poseArm } from "./cell/arm";
import { Orbit } from "./camera/camera";
import { drawCameras, drawFrustum, drawPlanned, poseFrustum } from "./cell/cameras";
import { drawCloud } from "./points/cloud";
import { drawCrossings } from "./strings/crossings";
import { DIRECTIONS, pointsToFrame } from "./camera/framing";
import { closeGraphics, openGraphics } from "./graphics";
import { drawGrasps } from "./grasps/grasps";
import { drawHeights } from "./points/heights";
import { LabelLayer } from "./labels/labels";
import { drawMark, whereIs } from "./strings/highlight";
import { drawEarlier, drawOthers } from "./strings/compared_methods";
import { drawMeasured } from "./strings/measured";
import { paletteOf, type Scheme } from "./palette";
import { Part } from "./part";
import { pick } from "./picking/pick";
import { type Caption, pictureOf } from "./picture";
import { PIXEL, SHARPNESS } from "./points/pixel";
import { readCloud } from "./points/ply";
import { drawGeometry } from "./cell/geometry";
import { Scale } from "./labels/scale";
import type { Content, Layer, Target } from "./scene";
import { covered, pixelsAhead, type Screen } from "./camera/screen";
import { drawStrings } from "./strings/strings";
import { onTap } from "./picking/tap";
import { drawViewClouds } from "./points/view_clouds";
import type { View3D } from "./view3d";

/** Pause between frames of a moving arm without a graphics card. */
const SLOW_ARM_MS = 1000;

const NOTHING: Content = {
  model: null, grasps: [], cloud: null, views: [], geometry: null, gripper: null, q_rad: null, others: [],
  heights: null, measured: null, earlier: null, planned: null, lens: null, viewClouds: [],
};

/** Holds the content and draws it only when something has changed. */
export class Stage implements View3D {
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly orbit: Orbit;
  private readonly labels: LabelLayer;
  private readonly scale: Scale;
  private readonly ends = new AbortController();
  private readonly resized = new ResizeObserver(() => this.resize());
  private readonly parts = {
    heights: new Part(this.scene, drawHeights),
    cloud: new Part(this.scene, drawCloud),
    strings: new Part(this.scene, drawStrings),
    others: new Part(this.scene, drawOthers),
    earlier: new Part(this.scene, drawEarlier),
    crossings: new Part(this.scene, drawCrossings),
    grasps: new Part(this.scene, drawGrasps),
    viewClouds: new Part(this.scene, drawViewClouds),
    cameras: new Part(this.scene, drawCameras),
    planned: new Part(this.scene, drawPlanned),
    frustum: new Part(this.scene, drawFrustum),
    arm: new Part(this.scene, drawArm),
    geometry: new Part(this.scene, drawGeometry),
    mark: new Part(this.scene, drawMark),
    measured: new Part(this.scene, drawMeasured),
  };
  private content = NOTHING;
  private points: Float32Array | null = null;
  private shown: ReadonlySet<Layer> = new Set(["cloud", "strings", "crossings", "labels", "geometry"]);
  private marked: Target | null = null;
  private palette;
  private frames = 0;
  private frameRequest: number | null = null;
  private armFrame: ReturnType<typeof setTimeout> | null = null;
  private readonly armPause_ms: number;
  /** Whether the next frame shows the whole content, because it is new. */
  private needsFit = true;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly overlay: HTMLElement,
    picked: (target: Target) => void,
  ) {
    const graphics = openGraphics(canvas);
    this.renderer = graphics.renderer;
    this.armPause_ms = graphics.isSlow ? SLOW_ARM_MS : 0;
    this.palette = paletteOf(canvas, matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
    this.orbit = new Orbit(canvas, () => this.requestFrame());
    this.scene.add(this.orbit.camera, new AmbientLight(0xffffff, 2));
    this.labels = new LabelLayer(overlay);
    this.scale = new Scale(overlay);
    const { signal } = this.ends;
    canvas.addEventListener("webglcontextlost", () => this.empty(), { signal });
    canvas.addEventListener("webglcontextrestored", () => this.update(), { signal });
    signal.addEventListener("abort", onTap(canvas, (x, y) => this.tapped(x, y, picked)));
    canvas.dataset.frames = "0";
    this.update();
    this.resized.observe(canvas);
  }

  show(content: Content): void {
    if (content.cloud !== this.content.cloud) this.points = content.cloud && readCloud(content.cloud);
    if (content.model !== this.content.model) this.marked = null;
    const isNew = content.model !== this.content.model || content.planned?.path !== this.content.planned?.path;
    if (isNew) this.needsFit = true;
    this.content = content;
    this.canvas.dataset.points = String((this.points?.length ?? 0) / 3);
    this.canvas.dataset.viewClouds = String(content.viewClouds.length);
    this.update();
  }

  layers(shown: ReadonlySet<Layer>): void {
    this.shown = new Set(shown);
    this.update();
  }

  arm(q_rad: readonly number[] | null): void {
    this.content = { ...this.content, q_rad };
    this.canvas.dataset.joints = q_rad === null ? "" : q_rad.join(" ");
    this.poseArm();
    if (this.shown.has("arm")) this.requestArmFrame();
  }

  mark(target: Target | null): void {
    this.marked = target;
    this.update();
  }

  focus(target: Target): void {
    this.mark(target);
    const where = whereIs(target, this.content);
    if (where === null) return;
    this.needsFit = false;
    if (where.outline?.length) this.orbit.fit(where.outline);
    else this.orbit.approach(where.point, where.around_m);
  }

  viewFrom(from: "fit" | "top" | "side"): void {
    this.needsFit = !this.orbit.fit(this.outline(true), DIRECTIONS[from]);
    this.requestFrame();
  }

  zoom(factor: number): void {
    this.orbit.zoom(factor);
  }

  rotate(dx_rad: number, dy_rad: number): void {
    this.orbit.rotate(dx_rad, dy_rad);
  }

  scheme(scheme: Scheme): void {
    this.palette = paletteOf(this.canvas, scheme);
    this.update();
  }

  picture(caption: Caption): Promise<Blob> {
    this.draw();
    return pictureOf(this.canvas, this.overlay, caption);
  }

  dispose(): void {
    if (this.frameRequest !== null) cancelAnimationFrame(this.frameRequest);
    if (this.armFrame !== null) clearTimeout(this.armFrame);
    this.ends.abort();
    this.resized.disconnect();
    this.orbit.dispose();
    this.empty();
    this.scale.dispose();
    closeGraphics(this.renderer);
  }

  /** Free the parts when the graphics context is lost: they belong to the lost context. */
  private empty(): void {
    for (const part of Object.values(this.parts)) part.dispose();
  }

  /** Update the scene to the content and the shown layers. */
  private update(): void {
    const { parts, content, palette, shown } = this;
    const { model, geometry, views } = content;
    this.scene.background = palette.ground;
    parts.heights.update(content.heights, palette);
    parts.cloud.update(this.points, palette);
    parts.strings.update(model, palette);
    parts.others.update(content.others);
    parts.earlier.update(content.earlier);
    parts.crossings.update(model, palette);
    parts.grasps.update(content.grasps, this.marked?.kind === "grasp" ? this.marked.id : null, palette);
    parts.viewClouds.update(content.viewClouds, geometry);
    parts.cameras.update(views, model, palette);
    parts.planned.update(content.planned, palette);
    parts.frustum.update(content.lens, palette);
    parts.arm.update(geometry, palette);
    parts.geometry.update(geometry, palette);
    parts.mark.update(this.marked, content, palette);
    parts.measured.update(content.measured, palette);
    parts.others.visible = shown.has("strings");
    parts.viewClouds.visible = shown.has("cloud");
    parts.planned.visible = shown.has("cameras");
    parts.earlier.visible = shown.has("strings");
    for (const layer of ["heights", "cloud", "strings", "crossings", "grasps", "cameras", "geometry"] as const) {
      parts[layer].visible = shown.has(layer);
    }
    this.labels.show(shown.has("labels"));
    this.poseArm();
    this.requestFrame();
  }

  private outline(withArm: boolean): Vector3[] {
    return pointsToFrame(this.content, this.points, this.shown, this.marked, withArm);
  }

  private screen(): Screen {
    return { camera: this.orbit.camera, width: this.canvas.clientWidth, height: this.canvas.clientHeight };
  }

  private poseArm(): void {
    const { geometry, q_rad } = this.content;
    const { arm, frustum } = this.parts;
    arm.visible = frustum.visible = this.shown.has("arm") && q_rad !== null;
    if (geometry === null || q_rad === null) return;
    if (arm.group !== null) poseArm(arm.group, geometry.arm, q_rad);
    if (frustum.group !== null) poseFrustum(frustum.group, geometry.arm, q_rad);
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (width === 0 || height === 0) return;
    this.renderer.setSize(width, height, false);
    this.labels.setSize(width, height);
    this.orbit.setAspect(width / height);
    this.draw(); // at once: a canvas of a new size is empty
  }

  private requestFrame(): void {
    this.frameRequest ??= requestAnimationFrame(() => this.draw());
  }

  /** Request a frame for a moving arm. Without a graphics card, drawing each posture would take the whole processor. */
  private requestArmFrame(): void {
    this.armFrame ??= setTimeout(() => {
      this.armFrame = null;
      this.requestFrame();
    }, this.armPause_ms);
  }

  private draw(): void {
    const screen = this.screen();
    const can = screen.height > 0 && !this.renderer.getContext().isContextLost();
    // Between planned viewpoints the arm comes and goes; what it does there is in sight.
    const withArm = this.content.planned === null;
    if (this.needsFit && can) this.needsFit = !this.orbit.fit(this.outline(withArm), DIRECTIONS.fit);
    if (this.frameRequest !== null) cancelAnimationFrame(this.frameRequest);
    this.frameRequest = null;
    if (!can) return;
    PIXEL.value = 1 / pixelsAhead(screen);
    SHARPNESS.value = this.renderer.getPixelRatio();
    this.renderer.render(this.scene, this.orbit.camera);
    this.scale.update(pixelsAhead(screen) / this.orbit.distance_m);
    this.labels.draw(this.scene, screen, covered(this.content.model?.chains ?? [], screen), this.scale.area);
    this.canvas.dataset.frames = String(++this.frames);
  }

  private tapped(x: number, y: number, picked: (target: Target) => void): void {
    const labelled = this.shown.has("labels") ? this.labels.placeAt(x, y) : null;
    const place = labelled ?? pick(this.content, this.points, this.shown, this.screen(), x, y);
    if (place) picked(place);
  }
}
