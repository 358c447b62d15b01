import { BackSide, type Color, ShaderMaterial } from "three";
import { PIXEL } from "../points/pixel";

/** Return the material of an outline: the far side of a slightly larger hull, at least 1.5 pixels wide. */
export function outline(colour: Color, grow_m: number): ShaderMaterial {
  return new ShaderMaterial({
    side: BackSide,
    uniforms: { colour: { value: colour }, grow: { value: grow_m }, pixel: PIXEL },
    vertexShader: `
      uniform float grow;
      uniform float pixel;
      void main() {
        vec4 seen = modelViewMatrix * vec4(position, 1.0);
        vec3 out_of = normalize(normalMatrix * normal);
        seen.xyz += out_of * max(grow, -1.5 * pixel * seen.z);
        gl_Position = projectionMatrix * seen;
      }`,
    fragmentShader: `
      uniform vec3 colour;
      void main() {
        gl_FragColor = vec4(colour, 1.0);
        #include <colorspace_fragment>
      }`,
  });
}
