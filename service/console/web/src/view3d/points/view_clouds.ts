import { BufferAttribute, BufferGeometry, Group, Points, PointsMaterial } from "three";
import { colourOfHeight } from "./height_scale";
import { readCloud } from "./ply";
import type { CellGeometry } from "../scene";

/** Size of a point on the page, pixels. */
const POINT_PX = 2;

/** Draw the points of the views of a running scan, coloured by height above the table like the pictures of the views. */
export function drawViewClouds(clouds: readonly ArrayBuffer[], geometry: CellGeometry | null): Group {
  const group = new Group();
  const material = new PointsMaterial({ size: POINT_PX, sizeAttenuation: false, vertexColors: true });
  for (const cloud of clouds) {
    const points = readCloud(cloud);
    const colours = new Float32Array(points.length);
    for (let at = 0; at < points.length; at += 3) {
      colourOfHeight((points[at + 2] ?? 0) - (geometry?.table_z_m ?? 0)).toArray(colours, at);
    }
    const shape = new BufferGeometry();
    shape.setAttribute("position", new BufferAttribute(points, 3));
    shape.setAttribute("color", new BufferAttribute(colours, 3));
    group.add(new Points(shape, material));
  }
  return group;
}
