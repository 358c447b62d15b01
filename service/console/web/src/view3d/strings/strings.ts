import {
  CircleGeometry, type Color, ConeGeometry, Group, InstancedMesh, Mesh, MeshBasicMaterial, MeshLambertMaterial,
  Object3D, SphereGeometry, TorusGeometry, Vector3,
} from "three";
import { t } from "../../texts/translate";
import { pieceCount, pointAt } from "./arc_length";
import { cutMargins, oversOf, splitAtCrossings, type Piece } from "./gaps";
import { label } from "../labels/labels";
import { outline } from "./outline";
import type { Palette } from "../palette";
import type { Chain, Model } from "../scene";
import { colourAt, directionAt, tube } from "./tubes";

const UP = new Vector3(0, 0, 1);
/** In string radii: the bridge of a gap, the ball at an end, the ring at an end that is not free, a cone. */
const [GHOST, BALL, RING, CONE] = [0.25, 1.5, 2.2, 1.4];
const CONES_APART_M = 0.06;

/** Draw the strings as tubes coloured by order, with gaps where they pass below, directions and ends. */
export function drawStrings(model: Model | null, palette: Palette): Group {
  const group = new Group();
  for (const chain of model?.chains ?? []) {
    if (model !== null && chain.points.length > 0) group.add(drawChain(chain, model, palette));
  }
  return group;
}

function drawChain(chain: Chain, model: Model, palette: Palette): Group {
  const group = new Group();
  const r = chain.radius_m;
  const { shown, gaps } = splitAtCrossings(chain, model);
  for (const piece of shown) {
    group.add(...outlined(tube(chain, piece, r), palette.ink, 0.15 * r));
    if (!chain.closed || piece.to_m - piece.from_m < chain.length_m) group.add(...lids(chain, piece));
  }
  for (const gap of gaps) group.add(new Mesh(tube(chain, gap, GHOST * r), coloured()));
  const clear = cutMargins(shown, oversOf(chain, model), 4 * r, chain.length_m);
  group.add(drawCones(chain, clear, palette), drawEnds(chain, palette));
  return group;
}

function outlined(shape: Mesh["geometry"], ink: Color, grow_m: number): Mesh[] {
  return [new Mesh(shape, coloured()), new Mesh(shape, outline(ink, grow_m))];
}

function coloured(): MeshLambertMaterial {
  return new MeshLambertMaterial({ vertexColors: true });
}

/** Draw the caps of a tube. */
function lids(chain: Chain, piece: Piece): Mesh[] {
  return [piece.from_m, piece.to_m].map((s, which) => {
    const material = new MeshLambertMaterial({ color: colourAt(chain, s) });
    const lid = new Mesh(new CircleGeometry(chain.radius_m, 16), material);
    lid.position.fromArray(pointAt(chain, s).point);
    lid.quaternion.setFromUnitVectors(UP, direction(chain, s).multiplyScalar(which === 0 ? -1 : 1));
    return lid;
  });
}

/** Draw the direction of a string: cones along it, on pieces clear of crossings. */
function drawCones(chain: Chain, clear: readonly Piece[], palette: Palette): InstancedMesh {
  const r = chain.radius_m;
  const count = Math.max(1, Math.round(chain.length_m / CONES_APART_M));
  const wanted = Array.from({ length: count }, (_, k) => ((k + 0.5) / count) * chain.length_m);
  const places = wanted.map((s) => into(clear, [s, s + chain.length_m], 2 * r)).filter((s) => s !== null);
  const shape = new ConeGeometry(CONE * r, 2.6 * CONE * r, 14).rotateX(Math.PI / 2); // along z
  const cones = new InstancedMesh(shape, new MeshLambertMaterial({ color: palette.ink }), places.length);
  const pose = new Object3D();
  places.forEach((s, index) => {
    pose.position.fromArray(pointAt(chain, s).point);
    pose.quaternion.setFromUnitVectors(UP, direction(chain, s));
    pose.updateMatrix();
    cones.setMatrixAt(index, pose.matrix);
  });
  return cones;
}

/** Return the arc length nearest to a wanted one with a margin inside a piece; null if no piece is long enough. */
function into(pieces: readonly Piece[], wanted: readonly number[], margin_m: number): number | null {
  const near = pieces
    .filter((piece) => piece.to_m - piece.from_m > 2 * margin_m)
    .flatMap((piece) =>
      wanted.map((s) => {
        const target = Math.min(Math.max(s, piece.from_m + margin_m), piece.to_m - margin_m);
        return { target, moved: Math.abs(target - s) };
      }),
    );
  near.sort((a, b) => a.moved - b.moved);
  return near[0]?.target ?? null;
}

function drawEnds(chain: Chain, palette: Palette): Group {
  const group = new Group();
  const brief = t("viewer.label.string", { id: chain.id });
  const named = { target: { kind: "chain", id: chain.id }, around_m: BALL * chain.radius_m } as const;
  if (chain.closed) {
    group.add(label({ brief, detail: t("viewer.label.closed"), kind: "chain", rank: 1, ...named }, at(chain, 0)));
    return group;
  }
  chain.ends.forEach((end, which) => {
    const s = which === 0 ? 0 : chain.length_m;
    const name = which === 0 ? "first_end" : "last_end";
    const shown = which === 0 ? brief : t("viewer.label.last_end_of", { id: chain.id });
    const text =
      end === "free"
        ? { brief: shown, ...(which === 0 ? { detail: t("viewer.label.first_end") } : {}), kind: "chain" }
        : {
            brief: t("viewer.label.uncertain", { id: shown }),
            detail: t(`viewer.label.${name}_${end}`),
            kind: `chain ${end}`,
          };
    group.add(...(end === "free" ? ball(chain, s, palette) : ring(chain, s, palette)));
    group.add(label({ ...text, rank: 1 + which, ...named }, at(chain, s)));
  });
  return group;
}

/** Draw a free end: a full ball. */
function ball(chain: Chain, s: number, palette: Palette): Mesh[] {
  const shape = new SphereGeometry(BALL * chain.radius_m, 20, 12);
  const material = new MeshLambertMaterial({ color: colourAt(chain, s) });
  const meshes = [new Mesh(shape, material), new Mesh(shape, outline(palette.ink, 0.15 * chain.radius_m))];
  for (const mesh of meshes) mesh.position.fromArray(pointAt(chain, s).point);
  return meshes;
}

/** Draw an unobserved or touching end: an open ring. */
function ring(chain: Chain, s: number, palette: Palette): Mesh[] {
  const r = chain.radius_m;
  const mesh = new Mesh(new TorusGeometry(RING * r, 0.35 * r, 8, 28), new MeshBasicMaterial({ color: palette.warn }));
  mesh.position.fromArray(pointAt(chain, s).point);
  mesh.quaternion.setFromUnitVectors(UP, direction(chain, s));
  return [mesh];
}

function direction(chain: Chain, s: number): Vector3 {
  return directionAt(chain, s, (0.75 * chain.length_m) / pieceCount(chain));
}

function at(chain: Chain, s: number): Vector3 {
  return new Vector3().fromArray(pointAt(chain, s).point);
}
