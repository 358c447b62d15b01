import {
  Box3, Box3Helper, BoxGeometry, BufferGeometry, Color, ConeGeometry, EdgesGeometry, Float32BufferAttribute, Group,
  LineBasicMaterial, LineSegments, Mesh, MeshBasicMaterial,
  MeshLambertMaterial, Vector3,
} from "three";
import { label } from "../labels/labels";
import { rod } from "../rod";
import type { Palette } from "../palette";
import type { CellGeometry } from "../scene";

const [FINE_M, COARSE_M] = [0.01, 0.1];
/** A table larger than this has no fine grid. */
const FINE_UP_TO_M = 1.5;
const [AXIS_M, AXIS_RADIUS_M, TIP_M] = [0.06, 0.0006, 0.006];

/** Draw the workspace, the table with a grid of 10 mm, obstacles, and the axes of the base frame. */
export function drawGeometry(geometry: CellGeometry | null, palette: Palette): Group {
  const group = new Group();
  group.add(axes(palette));
  if (geometry === null) return group;
  group.add(new Box3Helper(workspaceOf(geometry), palette.muted), grid(geometry, palette));
  for (const corners of geometry.obstacles_m) group.add(obstacle(corners, palette));
  return group;
}

/** Draw the workspace, in which strings are searched. */
export function workspaceOf(geometry: CellGeometry): Box3 {
  const [x, y, z] = geometry.workspace_m;
  const corner = (which: 0 | 1) => new Vector3(x?.[which] ?? 0, y?.[which] ?? 0, z?.[which] ?? 0);
  return new Box3(corner(0), corner(1));
}

/** Draw the table below the workspace as a grid; lines at each 100 mm are stronger and labelled at the edge. */
function grid(geometry: CellGeometry, palette: Palette): Group {
  const group = new Group();
  const { min, max } = workspaceOf(geometry);
  const z = geometry.table_z_m;
  const wide = Math.max(max.x - min.x, max.y - min.y);
  const along = (step: number, x: boolean) => steps(x ? min.x : min.y, x ? max.x : max.y, step);
  const lines = (step: number) => [
    ...along(step, true).flatMap((x) => [x, min.y, z, x, max.y, z]),
    ...along(step, false).flatMap((y) => [min.x, y, z, max.x, y, z]),
  ];
  if (wide <= FINE_UP_TO_M) group.add(drawLines(lines(FINE_M), palette.line, 0.6));
  group.add(drawLines(lines(COARSE_M), palette.muted, 0.9));
  for (const x of along(COARSE_M, true)) group.add(edgeLabel(x, new Vector3(x, min.y, z), "x"));
  for (const y of along(COARSE_M, false)) group.add(edgeLabel(y, new Vector3(min.x, y, z), "y"));
  return group;
}

function edgeLabel(value_m: number, at: Vector3, axis: string) {
  return label({ brief: `${axis} ${Math.round(value_m * 1000)}`, kind: "tick", rank: 50 }, at);
}

/** Return the multiples of a step within a range. */
function steps(from: number, to: number, step: number): number[] {
  const first = Math.ceil(from / step - 1e-9);
  const count = Math.floor(to / step + 1e-9) - first + 1;
  return Array.from({ length: Math.max(count, 0) }, (_, k) => (first + k) * step);
}

function drawLines(coordinates: readonly number[], colour: Color, opacity: number): LineSegments {
  const shape = new BufferGeometry();
  shape.setAttribute("position", new Float32BufferAttribute(coordinates, 3));
  const material = new LineBasicMaterial({ color: colour, transparent: true, opacity, depthWrite: false });
  return new LineSegments(shape, material);
}

function obstacle(corners: CellGeometry["obstacles_m"][number], palette: Palette): Group {
  const [low, high] = [0, 1].map((which) => new Vector3().fromArray(corners[which] ?? [0, 0, 0]));
  const group = new Group();
  if (!low || !high) return group;
  const size = high.clone().sub(low);
  const shape = new BoxGeometry(size.x, size.y, size.z);
  const body = new MeshLambertMaterial({ color: palette.muted, transparent: true, opacity: 0.3, depthWrite: false });
  const edges = new LineBasicMaterial({ color: palette.muted });
  group.add(new Mesh(shape, body), new LineSegments(new EdgesGeometry(shape), edges));
  group.position.copy(low).addScaledVector(size, 0.5);
  return group;
}

/** Draw the axes of the robot's base. */
function axes(palette: Palette): Group {
  const group = new Group();
  const dark = palette.ground.getHSL({ h: 0, s: 0, l: 0 }).l < 0.5;
  const colours: Record<string, string> = dark
    ? { x: "#ff8080", y: "#74d674", z: "#8fb4ff" }
    : { x: "#b00020", y: "#0b6b1d", z: "#1440c0" };
  const ways = { x: new Vector3(1, 0, 0), y: new Vector3(0, 1, 0), z: new Vector3(0, 0, 1) };
  for (const [name, way] of Object.entries(ways)) {
    const colour = new Color(colours[name] ?? palette.ink);
    const end = way.clone().multiplyScalar(AXIS_M);
    const tip = new Mesh(new ConeGeometry(0.35 * TIP_M, TIP_M, 12), new MeshBasicMaterial({ color: colour }));
    tip.position.copy(end);
    tip.quaternion.setFromUnitVectors(new Vector3(0, 1, 0), way);
    group.add(rod(new Vector3(), end, AXIS_RADIUS_M, colour), tip);
    group.add(label({ brief: name, kind: "axis", rank: 3 }, end));
  }
  return group;
}
