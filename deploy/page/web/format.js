// Formats numbers for display.

const whole = new Intl.NumberFormat("en-US");

/** Formats a count with thousands separators. */
export const count = (number) => (number === null ? "-" : whole.format(Math.round(number)));

/** Formats a share in percent. */
export const percent = (share) => (share === null || share === undefined ? "-" : `${Number((100 * share).toFixed(1))} %`);

/** Formats a number to at most four significant digits. */
export function short(number) {
  if (number === null || !Number.isFinite(number)) return "-";
  const size = Math.abs(number);
  if (size >= 1e6) return `${Number((number / 1e6).toPrecision(4))} M`;
  if (size >= 1e4) return `${Number((number / 1e3).toPrecision(4))} k`;
  if (size !== 0 && size < 1e-3) return number.toExponential(1);
  return String(Number(number.toPrecision(4)));
}

/** Formats a number of seconds as a duration. */
export function duration(seconds) {
  if (seconds === null || seconds === undefined) return "-";
  if (seconds < 60) return `${seconds.toFixed(0)} s`;
  const [hours, minutes] = [Math.floor(seconds / 3600), Math.floor((seconds % 3600) / 60)];
  return hours > 0 ? `${hours} h ${minutes} min` : `${minutes} min ${Math.floor(seconds % 60)} s`;
}

/** Formats seconds since 1970 as date and time. */
export const date = (seconds) => new Date(1000 * seconds).toLocaleString([], { dateStyle: "short", timeStyle: "short" });
