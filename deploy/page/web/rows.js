// The rows of a collection of episodes, and filters on them.

import * as api from "./api.js";
import { compare } from "./sorting.js";

const SOURCES = ["training", "evaluation", "demonstration"];

/** The rows of a collection that have been read so far. */
export class Rows {
  constructor(run, collection) {
    [this.run, this.collection] = [run, collection];
    [this.rows, this.generation, this.trouble] = [[], 0, []];
  }

  /** Reads new rows. */
  async read() {
    const found = await api.episodes(this.run, this.collection, this.generation, this.rows.length);
    this.rows.length = found.from;
    const { columns, rows, generation, trouble } = found;
    for (const values of rows) {
      const row = { place: this.rows.length };
      columns.forEach((column, index) => { row[column] = values[index]; });
      row.source = SOURCES[row.source];
      this.rows.push(row);
    }
    [this.generation, this.trouble] = [generation, trouble];
  }

  /** Returns the rows that match a filter, sorted. */
  chosen(filter, { key, falls }) {
    const matches = matcher(filter);
    const sign = falls ? -1 : 1;
    return this.rows.filter(matches).sort((a, b) => sign * compare(a[key], b[key]) || a.place - b.place);
  }
}

/** Returns the predicate of a filter: words such as `failed` and `training`, and comparisons such as `steps<20`. */
function matcher(filter) {
  const wishes = filter.toLowerCase().split(/[\s,]+/).filter(Boolean).map(wish);
  return (row) => wishes.every((holds) => holds(row));
}

function wish(word) {
  const [, column, sign, number] = word.match(/^([a-z_]+)([<>=:])(-?[\d.e-]+)$/) ?? [];
  if (column) {
    const bound = Number(number);
    const holds = { "<": (value) => value < bound, ">": (value) => value > bound }[sign] ?? ((value) => value === bound);
    return (row) => typeof row[column] === "number" && holds(row[column]);
  }
  // Where the task does not tell success, it is null, and an episode is neither.
  if ("failed".startsWith(word)) return (row) => row.success === false;
  if ("successful".startsWith(word)) return (row) => row.success === true;
  return (row) => row.source.startsWith(word);
}
