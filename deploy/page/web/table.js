// A long table of which only the visible rows are in the document.

import { arrange, element } from "./dom.js";
import { Head } from "./sorting.js";

const ROWS_BEYOND = 8;

/** A table with `columns` of `{key, label, text, show}`. `onchoose` is called with the selected row. */
export class LongTable {
  constructor(columns, sorting, { onsort, onchoose }) {
    Object.assign(this, { columns, onchoose });
    [this.rows, this.chosen, this.kept] = [[], null, new Map()];
    this.head = new Head(columns, sorting, onsort);
    this.body = element("tbody");
    this.above = element("tr", { "aria-hidden": "true" });
    this.below = element("tr", { "aria-hidden": "true" });
    this.head.row.setAttribute("aria-rowindex", 1);
    this.grid = element("table", {
      role: "grid", tabindex: 0, "aria-label": "Episodes", onkeydown: (event) => this.step(event),
    }, element("thead", {}, this.head.row), this.body);
    this.place = element("div", { class: "long", onscroll: () => this.draw() }, this.grid);
  }

  /** Shows other rows. */
  show(rows) {
    this.rows = rows;
    this.grid.setAttribute("aria-rowcount", rows.length + 1);
    this.draw();
  }

  /** Marks a row as selected, and scrolls to it if it is out of view. */
  choose(row) {
    this.chosen = row.place;
    const at = this.rows.indexOf(row);
    const [top, height] = [at * this.rowHeight, this.place.clientHeight - 2 * this.rowHeight];
    if (at >= 0 && (top < this.place.scrollTop || top > this.place.scrollTop + height)) this.place.scrollTop = top;
    this.draw();
    this.grid.setAttribute("aria-activedescendant", name(row));
  }

  /** Marks no row as selected. */
  forget() {
    this.chosen = null;
    this.grid.removeAttribute("aria-activedescendant");
  }

  step(event) {
    const direction = { ArrowUp: -1, ArrowDown: 1 }[event.key];
    const next = this.rows[this.rows.findIndex((row) => row.place === this.chosen) + direction];
    if (!direction || !next) return;
    event.preventDefault();
    this.onchoose(next);
  }

  /** Draws one row to learn the height of all, which depends on the browser's fonts. */
  measure() {
    this.body.replaceChildren(this.drawn(this.rows[0]));
    this.rowHeight = this.body.firstChild.offsetHeight;
  }

  draw() {
    if (this.rows.length === 0) {
      this.body.replaceChildren();
      return;
    }
    if (!this.rowHeight) this.measure();
    const first = Math.max(0, Math.floor(this.place.scrollTop / this.rowHeight) - ROWS_BEYOND);
    // The table is lower than the window. Its own height depends on the rows that are drawn.
    const count = Math.ceil(innerHeight / this.rowHeight) + 2 * ROWS_BEYOND;
    const seen = this.rows.slice(first, first + count);
    this.above.style.height = `${first * this.rowHeight}px`;
    this.below.style.height = `${Math.max(0, this.rows.length - first - seen.length) * this.rowHeight}px`;
    // Rows keep their nodes, so that one that moves between press and release is still clicked.
    const kept = new Map(seen.map((row) => [row, this.kept.get(row) ?? this.drawn(row)]));
    this.kept = kept;
    seen.forEach((row, index) => {
      kept.get(row).setAttribute("aria-rowindex", first + index + 2);
      kept.get(row).setAttribute("aria-selected", String(row.place === this.chosen));
    });
    arrange(this.body, [this.above, ...kept.values(), this.below]);
  }

  drawn(row) {
    const cells = this.columns.map(({ key, text, show }) => {
      const shown = show ? show(row) : String(row[key]);
      return element("td", { class: text ? "text" : null }, shown);
    });
    return element("tr", { id: name(row), onclick: () => this.onchoose(row) }, cells);
  }
}

function name(row) {
  return `row-${row.place}`;
}
