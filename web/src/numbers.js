// Numbers as they are read.

const RAISED = { "-": "⁻", 0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹" };

/** Returns a number with so many digits, such as −1.2×10⁻⁵. */
export function number(value, digits = 5) {
  if (value === null || Number.isNaN(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e-4 && size < 10 ** Math.max(digits, 6)) {
    return String(Number(value.toPrecision(digits))).replace("-", "−");
  }
  const [mantissa, exponent] = value.toExponential(digits - 1).split("e");
  const power = [...String(Number(exponent))].map((letter) => RAISED[letter]).join("");
  return `${Number(mantissa)}×10${power}`.replace("-", "−");
}

/** Returns a length in m, mm or µm. */
export function length(metres) {
  for (const [unit, factor] of [["m", 1], ["mm", 1e3], ["µm", 1e6]]) {
    if (Math.abs(metres) * factor >= 1) return `${number(metres * factor, 3)}\u202f${unit}`;
  }
  return `${number(metres * 1e9, 3)}\u202fnm`;
}

/** Returns a pressure in Pa, kPa, MPa or GPa. */
export function pressure(pascals) {
  const [unit, factor] = pascals >= 1e9 ? ["GPa", 1e-9] : pascals >= 1e6 ? ["MPa", 1e-6] : pascals >= 1e3 ? ["kPa", 1e-3] : ["Pa", 1];
  return `${number(pascals * factor, 3)}\u202f${unit}`;
}

/** Returns a force in N, kN or mN. */
export function force(newtons) {
  const [unit, factor] = newtons >= 1e4 ? ["kN", 1e-3] : newtons < 0.1 ? ["mN", 1e3] : ["N", 1];
  return `${number(newtons * factor, 3)}\u202f${unit}`;
}
