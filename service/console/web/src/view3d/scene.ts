import type { components } from "../../generated/api";

/** The point chain model, and its parts. */
export type Model = components["schemas"]["ModelDocument"];
export type Chain = components["schemas"]["ChainDocument"];
export type Crossing = components["schemas"]["CrossingDocument"];
export type Grasp = components["schemas"]["GraspDocument"];
/** Metres, base frame. */
export type Point = readonly [number, number, number];
/** A pose as 4 rows of 4. */
export type Pose = ViewPose["T_base_camera"];

/** A layer that can be shown or hidden. */
export type Layer = "cloud" | "strings" | "crossings" | "grasps" | "cameras" | "arm" | "labels" | "geometry" | "heights";

/** The camera pose of a view. */
export type ViewPose = components["schemas"]["ViewResource"];
/** What of a view is drawn in 3D. */
export type CameraPose = Pick<ViewPose, "index" | "T_base_camera" | "K" | "width" | "height">;
/** A capsule of the arm: all points within a radius of a segment. */
export type ArmCapsule = components["schemas"]["ArmCapsule"];
/** An arm's Denavit-Hartenberg table and its shape. */
export type ArmGeometry = components["schemas"]["ArmGeometry"];
/** The cell around the strings. */
export type CellGeometry = components["schemas"]["CellGeometry"];
/** The dimensions of the configured gripper. */
export type Gripper = CellGeometry["gripper"];

/** Heights of the table and of what lies on it, in square cells. */
export type HeightMap = components["schemas"]["HeightMapDocument"];

/** The viewpoints that the arm has not reached yet. */
export interface PlannedPath {
  views: readonly CameraPose[];
  /** All reachable viewpoints in the order of the path. */
  path: readonly CameraPose[];
}

/** The camera on the flange. */
export interface Lens {
  T_flange_camera: Pose;
  K: ViewPose["K"];
  width: number;
  height: number;
}

/** The result of another method from the same views. */
export interface Other {
  method: components["schemas"]["ScanResource"]["method"];
  model: Model;
}

/** A distance that a person measures; `to` is null until the second position is selected. */
export interface Measured {
  from: Point;
  to: Point | null;
}

/** The content to draw; unknown parts are null or empty. */
export interface Content {
  model: Model | null;
  /** The grasps of the model that are drawn: all of them would hide the strings. */
  grasps: readonly Grasp[];
  /** `cloud.ply` as served. */
  cloud: ArrayBuffer | null;
  views: readonly CameraPose[];
  geometry: CellGeometry | null;
  /** The gripper of the grasps, if it is the configured one. */
  gripper: Gripper | null;
  /** Current joint angles; null: the arm is not drawn. */
  q_rad: readonly number[] | null;
  others: readonly Other[];
  heights: HeightMap | null;
  planned: PlannedPath | null;
  /** The camera on the arm, whose field of view is drawn. */
  lens: Lens | null;
  /** The points of each view of a running scan, as PLY files. */
  viewClouds: readonly ArrayBuffer[];
  measured: Measured | null;
  /** The model of an earlier scan of the same table. */
  earlier: Model | null;
}

/** A part of the scene that can be selected. */
export type Target =
  | { kind: "point"; chain: number; s_m: number }
  | { kind: "crossing"; id: number }
  | { kind: "chain"; id: number }
  | { kind: "part"; chain: number; from_m: number; to_m: number }
  | { kind: "view"; index: number }
  | { kind: "at"; point: Point }
  | { kind: "grasp"; id: number }
  | { kind: "change"; change: ChainChange };

/** A string in this model, in the earlier one, or in both. */
export interface ChainChange {
  /** Id of the chain in this model; null: it is gone. */
  chain: number | null;
  /** Id of the chain in the earlier model; null: it is new. */
  before: number | null;
  /** Motion from points before to points now; null: it did not move, or is in one model only. */
  T_now_before: Pose | null;
}

/** Style of a line that represents a string. */
export type LineStyle = "solid" | "dashed" | "dotted";

/** How the strings of an earlier scan are drawn. */
export const EARLIER_LINE: { style: LineStyle; colour: string } = { style: "dashed", colour: "#ff9f6b" };

/** Return how the strings of a compared method are drawn: light, because they have a dark rim. */
export function lineOf(method: string): { style: LineStyle; colour: string } {
  if (method === "enhanced") return { style: "dashed", colour: "#ffd24d" };
  if (method === "matching") return { style: "dotted", colour: "#7fe3ff" };
  return { style: "solid", colour: "#ffffff" };
}

/** With a lower confidence, a crossing or a match of two strings is shown as not certain. */
export const CERTAIN_CONFIDENCE = 0.9;

/** Return whether a person must check a crossing. */
export function isUncertain(crossing: Crossing): boolean {
  return crossing.confidence < CERTAIN_CONFIDENCE;
}
