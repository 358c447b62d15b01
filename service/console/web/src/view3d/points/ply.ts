/** Return the points of the service's `cloud.ply`: float x, y, z of each point. */
export function readCloud(bytes: ArrayBuffer): Float32Array {
  const head = new TextDecoder("latin1").decode(new Uint8Array(bytes, 0, Math.min(bytes.byteLength, 1024)));
  const end = head.indexOf("end_header\n") + "end_header\n".length;
  const count = Number(/^element vertex (\d+)$/m.exec(head)?.[1]);
  if (end < "end_header\n".length || !head.includes("binary_little_endian") || !Number.isSafeInteger(count)) {
    throw new Error("the cloud is not a file as this service writes it");
  }
  if (bytes.byteLength < end + 12 * count) throw new Error("the cloud's file is cut off");
  return new Float32Array(bytes.slice(end, end + 12 * count)); // little endian, as on all machines with a browser
}
