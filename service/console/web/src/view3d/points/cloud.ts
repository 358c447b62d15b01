import { BufferAttribute, BufferGeometry, Group, Points, ShaderMaterial } from "three";
import type { Palette } from "../palette";
import { PIXEL, SHARPNESS } from "./pixel";

/** Size of a point in the scene; on the page it is 1.5 to 4 pixels wide. */
const POINT_M = 0.0005;

/** Draw the cloud, coloured by height from dark (low) to light (high). */
export function drawCloud(xyz: Float32Array | null, palette: Palette): Group {
  const group = new Group();
  if (xyz === null || xyz.length === 0) return group;
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(xyz, 3));
  geometry.computeBoundingBox();
  const [low, high] = [geometry.boundingBox?.min.z ?? 0, geometry.boundingBox?.max.z ?? 0];
  const material = new ShaderMaterial({
    uniforms: {
      low: { value: low },
      span: { value: Math.max(high - low, 1e-6) },
      lowColour: { value: palette.cloudLow },
      highColour: { value: palette.cloudHigh },
      pixel: PIXEL,
      sharpness: SHARPNESS,
    },
    vertexShader: `
      uniform float low;
      uniform float span;
      uniform float pixel;
      uniform float sharpness;
      varying float height;
      void main() {
        vec4 seen = modelViewMatrix * vec4(position, 1.0);
        height = (position.z - low) / span;
        gl_Position = projectionMatrix * seen;
        gl_PointSize = sharpness * clamp(${POINT_M} / (-seen.z * pixel), 1.5, 4.0);
      }`,
    fragmentShader: `
      uniform vec3 lowColour;
      uniform vec3 highColour;
      varying float height;
      void main() {
        gl_FragColor = vec4(mix(lowColour, highColour, height), 1.0);
        #include <colorspace_fragment>
      }`,
  });
  group.add(new Points(geometry, material));
  return group;
}
