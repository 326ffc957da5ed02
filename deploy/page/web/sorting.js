// Tables that people sort by pressing the head of a column.

import { button, element } from "./dom.js";

/** The cells of a head, one for each `{key, label, text}`; `onsort` is told of the order `{key, falls}` that is asked for. */
export function head(columns, { key: sorted, falls }, onsort) {
  return columns.map(({ key, label, text }) => {
    const order = key === sorted ? (falls ? "descending" : "ascending") : null;
    const sort = button(label, () => onsort({ key, falls: key === sorted ? !falls : !text }));
    return element("th", { class: text ? "text" : null, "aria-sort": order, scope: "col" }, sort);
  });
}

/** Which of two values comes first in a rising order; what is not known does. */
export function compare(a, b) {
  if (a === b) return 0;
  if (a === null) return -1;
  if (b === null) return 1;
  return a < b ? -1 : 1;
}
