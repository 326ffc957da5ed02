// A long table of which only the visible rows are in the document.

import { element } from "./dom.js";
import { Head } from "./sorting.js";

const ROW_HEIGHT = 28;
const ROWS_BEYOND = 8;

/** A table with `columns` of `{key, label, text, show}`. `onchoose` is called with the selected row. */
export class LongTable {
  constructor(columns, sorting, { onsort, onchoose }) {
    Object.assign(this, { columns, onchoose });
    [this.rows, this.chosen] = [[], null];
    this.head = new Head(columns, sorting, onsort);
    this.body = element("tbody");
    this.above = element("tr", { "aria-hidden": "true" });
    this.below = element("tr", { "aria-hidden": "true" });
    this.place = element("div", {
      class: "long", tabindex: 0, role: "region", "aria-label": "Episodes",
      onscroll: () => this.draw(), onkeydown: (event) => this.step(event),
    }, element("table", {}, element("thead", {}, this.head.row), this.body));
  }

  /** Shows other rows. */
  show(rows) {
    this.rows = rows;
    this.draw();
  }

  /** Marks a row as selected, and scrolls to it if it is out of view. */
  choose(row) {
    this.chosen = row?.place;
    const at = this.rows.indexOf(row);
    const [top, height] = [at * ROW_HEIGHT, this.place.clientHeight - 2 * ROW_HEIGHT];
    if (at >= 0 && (top < this.place.scrollTop || top > this.place.scrollTop + height)) this.place.scrollTop = top;
    this.draw();
  }

  step(event) {
    const direction = { ArrowUp: -1, ArrowDown: 1 }[event.key];
    const next = this.rows[this.rows.findIndex((row) => row.place === this.chosen) + direction];
    if (!direction || !next) return;
    event.preventDefault();
    this.onchoose(next);
  }

  draw() {
    const first = Math.max(0, Math.floor(this.place.scrollTop / ROW_HEIGHT) - ROWS_BEYOND);
    const count = Math.ceil((this.place.clientHeight || 400) / ROW_HEIGHT) + 2 * ROWS_BEYOND;
    const seen = this.rows.slice(first, first + count);
    this.above.style.height = `${first * ROW_HEIGHT}px`;
    this.below.style.height = `${Math.max(0, this.rows.length - first - seen.length) * ROW_HEIGHT}px`;
    this.body.replaceChildren(this.above, ...seen.map((row) => this.drawn(row)), this.below);
  }

  drawn(row) {
    const cells = this.columns.map(({ key, text, show }) => {
      const shown = show ? show(row) : String(row[key]);
      return element("td", { class: text ? "text" : null }, shown);
    });
    const isChosen = row.place === this.chosen;
    return element("tr", {
      class: isChosen ? "chosen" : null, "aria-selected": String(isChosen), onclick: () => this.onchoose(row),
    }, cells);
  }
}
