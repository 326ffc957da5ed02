// Tables that are sorted by clicking the head of a column.

import { button, element } from "./dom.js";

/** The head of a table with `columns` of `{key, label, text}`. Columns without a label cannot be sorted by. */
export class Head {
  constructor(columns, sorting, onsort) {
    Object.assign(this, { columns, onsort });
    this.cells = columns.map((column) => this.cell(column));
    this.row = element("tr", {}, this.cells);
    this.sort(sorting);
  }

  cell({ key, label, text }) {
    const press = () => {
      const { key: sorted, falls } = this.sorting;
      this.sort({ key, falls: key === sorted ? !falls : !text });
      this.onsort();
    };
    return element("th", { class: text ? "text" : null, scope: "col" }, label ? button(label, press) : null);
  }

  /** Sets the sort order, `{key, falls}`. */
  sort(sorting) {
    this.sorting = sorting;
    this.columns.forEach(({ key, label }, index) => {
      if (label && key === sorting.key) this.cells[index].setAttribute("aria-sort", sorting.falls ? "descending" : "ascending");
      else this.cells[index].removeAttribute("aria-sort");
    });
  }
}

/** Compares two values for ascending order; null comes first. */
export function compare(a, b) {
  if (a === b) return 0;
  if (a === null) return -1;
  if (b === null) return 1;
  return a < b ? -1 : 1;
}
