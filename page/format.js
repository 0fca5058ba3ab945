// Numbers as texts, also those that are not known.

/** Returns a number with so many digits and a unit, or a dash if it is not known. */
export function format(/** @type {unknown} */ value, digits = 0, unit = "") {
  return typeof value === "number" && Number.isFinite(value) ? `${value.toFixed(digits)}${unit}` : "–";
}

/** Returns a share, 0 to 1, in percent, or a dash if it is not known. */
export function percent(/** @type {unknown} */ share, digits = 0) {
  return typeof share === "number" ? format(share * 100, digits, " %") : "–";
}
