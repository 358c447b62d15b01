/** The screen. */
export function CalibrationScreen() {
  return <h1>Calibration</h1>;
}
