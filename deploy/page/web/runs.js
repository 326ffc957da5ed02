// The list of runs, which can be sorted, filtered, and selected for comparison.

import { arrange, button, element } from "./dom.js";
import { count, date, duration, percent } from "./format.js";
import { compare, Head } from "./sorting.js";

const COLUMNS = [
  { key: "id", label: "run", text: true, show: link },
  { key: "state", label: "state", text: true, show: (run) => element("span", { class: `state ${run.state}` }, run.state) },
  { key: "task", label: "task", text: true },
  { key: "method", label: "method", text: true },
  { key: "preset", label: "preset", text: true },
  { key: "seed", label: "seed" },
  { key: "environment_steps", label: "steps", show: steps },
  { key: "success_rate", label: "success", show: (run) => percent(run.success_rate) },
  { key: "evaluated_success_rate", label: "evaluation", show: (run) => percent(run.evaluated_success_rate) },
  { key: "wall_s", label: "time", show: (run) => duration(run.wall_s) },
  { key: "begun", label: "begun", show: (run) => date(run.begun) },
  { label: "episodes", show: watch },
];

/** The view of all runs. */
export class ListView {
  constructor(place) {
    this.chosen = new Set();
    this.list = null;
    this.head = new Head(COLUMNS, { key: "begun", falls: true }, () => this.draw());
    this.head.row.prepend(element("th", { "aria-label": "chosen" }));
    // The row of each run. Rows are updated in place while runs train, so that the focus stays where it is.
    this.rows = new Map();
    this.filter = element("input", {
      id: "filter", type: "search", placeholder: "Filter ( / )", "aria-label": "Filter runs",
      oninput: () => this.draw(),
    });
    this.compare = button("Compare", () => {
      location.hash = `#/compare/${[...this.chosen].map(encodeURIComponent).join(",")}`;
    });
    this.told = element("div", { role: "status" });
    this.body = element("tbody");
    this.table = element("div", { class: "scroll" }, element("table", {},
      element("thead", {}, this.head.row), this.body));
    place.replaceChildren(
      element("h1", {}, "Runs"),
      element("div", { class: "controls" }, this.filter, this.compare),
      this.told, this.table,
    );
  }

  /** Draws a new list. */
  show(list) {
    this.list = list;
    this.draw();
  }

  close() {}

  draw() {
    this.compare.disabled = this.chosen.size < 2;
    const { runs, trouble } = this.list;
    const shown = this.shown(runs);
    const lines = trouble.map((line) => element("p", { class: "trouble" }, line));
    if (runs.length === 0) lines.push(empty());
    else if (shown.length === 0) lines.push(element("p", {}, "No run matches the filter."));
    this.told.replaceChildren(...lines);
    this.table.hidden = shown.length === 0;
    arrange(this.body, shown.map((run) => this.row(run)));
  }

  shown(runs) {
    const words = this.filter.value.toLowerCase().split(/\s+/).filter(Boolean);
    const matches = (run) => {
      const text = [run.id, run.task, run.method, run.preset, run.state, `seed ${run.seed}`].join(" ").toLowerCase();
      return words.every((word) => text.includes(word));
    };
    const { key, falls } = this.head.sorting;
    const order = (a, b) => compare(a[key], b[key]) * (falls ? -1 : 1);
    return runs.filter(matches).sort(order);
  }

  /** Returns the row of a run; only cells that have changed are replaced. */
  row(run) {
    const cells = COLUMNS.map((column) => cell(column, run));
    const row = this.rows.get(run.id) ?? element("tr", {}, this.choice(run), cells);
    this.rows.set(run.id, row);
    cells.forEach((cell, index) => {
      const old = row.children[index + 1];
      if (!old.isEqualNode(cell)) old.replaceWith(cell);
    });
    return row;
  }

  choice(run) {
    const box = element("input", {
      type: "checkbox", checked: this.chosen.has(run.id), "aria-label": `Compare ${run.id}`,
      onchange: () => {
        if (box.checked) this.chosen.add(run.id);
        else this.chosen.delete(run.id);
        this.compare.disabled = this.chosen.size < 2;
      },
    });
    return element("td", {}, box);
  }
}

function cell({ key, text, show }, run) {
  return element("td", { class: text ? "text" : null }, show ? show(run) : String(run[key]));
}

function link(run) {
  return element("a", { href: `#/run/${encodeURIComponent(run.id)}` }, run.id);
}

function watch(run) {
  const href = `#/episodes/${encodeURIComponent(run.id)}`;
  return element("a", { href, "aria-label": `Watch ${run.id}` }, "watch");
}

function steps(run) {
  const bar = element("progress", { "aria-hidden": "true", max: run.steps_wanted, value: run.environment_steps });
  // Behavioral cloning takes no steps.
  const isMoving = run.state !== "finished" && run.steps_wanted > 0;
  return element("span", {}, isMoving ? bar : "", ` ${count(run.environment_steps)}`);
}

function empty() {
  return element("div", {},
    element("p", {}, "There are no runs here yet. To start one:"),
    element("pre", {}, "goalward train"));
}
