import type { components } from "../../generated/api";

/** The point chain model, and its parts. */
export type Model = components["schemas"]["ModelDocument"];
export type Chain = components["schemas"]["ChainDocument"];
export type Crossing = components["schemas"]["CrossingDocument"];
export type Grasp = components["schemas"]["GraspDocument"];
/** Metres, base frame. */
export type Point = readonly [number, number, number];
/** A pose as 4 rows of 4. */
export type Pose = readonly (readonly number[])[];

/** What can be shown or hidden. */
export type Layer = "cloud" | "strings" | "crossings" | "grasps" | "cameras" | "arm" | "labels" | "room";

/** From where a view was taken. */
export type ViewPose = components["schemas"]["SeenView"];
/** A capsule of the arm: all within a radius of a straight piece. */
export type ArmPart = components["schemas"]["PartResource"];
/** An arm's Denavit-Hartenberg table and its shape. */
export type ArmShape = components["schemas"]["ArmShape"];
/** The cell around the strings. */
export type Room = components["schemas"]["RoomResource"];

/** What another method made of the same views. */
export interface Other {
  method: string;
  model: Model;
}

/** All that there is to draw; what is not known yet is null or empty. */
export interface Content {
  model: Model | null;
  /** `cloud.ply` as served. */
  cloud: ArrayBuffer | null;
  views: readonly ViewPose[];
  room: Room | null;
  /** The arm's joints now; null: the arm is not drawn. */
  q_rad: readonly number[] | null;
  others: readonly Other[];
}

/** Something in the scene that can be pointed at. */
export type Place =
  | { kind: "point"; chain: number; s_m: number }
  | { kind: "crossing"; id: number }
  | { kind: "chain"; id: number }
  | { kind: "view"; index: number }
  | { kind: "at"; point: Point }
  | { kind: "grasp"; index: number };

/** Of a line that stands for a string. */
export type LineStyle = "solid" | "dashed" | "dotted";

/** How the strings of a compared method are drawn, for the legend too: light, for they have a dark rim. */
export function lineOf(method: string): { style: LineStyle; colour: string } {
  if (method === "enhanced") return { style: "dashed", colour: "#ffd24d" };
  if (method === "matching") return { style: "dotted", colour: "#7fe3ff" };
  return { style: "solid", colour: "#ffffff" };
}

/** Crossings below this are called not certain. */
export const SURE = 0.9;

/** So many grasps, the best, are listed and drawn: all of them would hide the strings. */
export const BEST_GRASPS = 5;

/** Whether a crossing is to be looked at by a person. */
export function isUnsure(crossing: Crossing): boolean {
  return crossing.confidence < SURE;
}
