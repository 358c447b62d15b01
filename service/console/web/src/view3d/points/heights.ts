import {
  type Color, DataTexture, Group, Mesh, MeshBasicMaterial, NearestFilter, PlaneGeometry, SRGBColorSpace,
} from "three";
import { colourOfHeight } from "./height_scale";
import type { Palette } from "../palette";
import type { HeightMap } from "../scene";

const UNMEASURED = [0, 0, 0, 0] as const;

/** Draw the height map flat on the table, below everything else. Cells that no view measured are not drawn. */
export function drawHeights(map: HeightMap | null, palette: Palette): Group {
  const group = new Group();
  const [columns, rows] = [map?.z_m.length ?? 0, map?.z_m[0]?.length ?? 0];
  if (map === null || columns === 0 || rows === 0) return group;
  const { x_m, y_m, cell_m, table_z_m } = map;
  const [width_m, height_m] = [columns * cell_m, rows * cell_m];
  // Without depth, so that strings and grid are drawn over it.
  const material = new MeshBasicMaterial({ map: textureOf(map, columns, rows, palette), alphaTest: 0.5, depthWrite: false });
  const plane = new Mesh(new PlaneGeometry(width_m, height_m), material);
  plane.position.set(x_m + width_m / 2, y_m + height_m / 2, table_z_m);
  plane.renderOrder = -1;
  return group.add(plane);
}

function textureOf({ z_m, table_z_m, min_object_height_m }: HeightMap, columns: number, rows: number, palette: Palette): DataTexture {
  const pixels = new Uint8Array(4 * columns * rows);
  const table = bytesOf(palette.table);
  z_m.forEach((column, i) =>
    column.forEach((z, j) => {
      const above_m = (z ?? 0) - table_z_m;
      const colour = Math.abs(above_m) < min_object_height_m ? table : bytesOf(colourOfHeight(above_m));
      pixels.set(z === null ? UNMEASURED : colour, 4 * (j * columns + i));
    }),
  );
  const texture = new DataTexture(pixels, columns, rows);
  texture.colorSpace = SRGBColorSpace;
  texture.magFilter = NearestFilter;
  texture.minFilter = NearestFilter;
  texture.needsUpdate = true;
  return texture;
}

function bytesOf(colour: Color): [number, number, number, number] {
  const hex = colour.getHex(SRGBColorSpace);
  return [hex >> 16, (hex >> 8) & 255, hex & 255, 255];
}
