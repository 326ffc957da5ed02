// One run, or several in the same charts: their curves, and the facts about a single run.

import * as api from "./api.js";
import { Chart } from "./chart.js";
import { button, element, renew } from "./dom.js";
import { compared, facts } from "./facts.js";
import { Processes } from "./processes.js";
import { band, CHARTS, points, smoothed, Updates } from "./series.js";
import { oneAtATime } from "./turns.js";

const COLORS = 8;
const AXES = ["environment_steps", "wall_s"];

/** The view of one or several runs. */
export class RunView {
  constructor(place, ids) {
    this.ids = ids;
    this.updates = ids.map((id) => new Updates(id));
    [this.known, this.troubles] = [new Map(), new Map()];
    this.refresh = oneAtATime(() => this.read());
    this.looks = { x: "environment_steps", weight: 0.6, bands: false };
    this.isOpen = true;
    this.trouble = element("div", { role: "alert" });
    this.legend = element("ul", { class: "legend" });
    this.facts = element("div");
    this.processes = ids.length === 1 ? new Processes(ids[0]) : null;
    this.charts = CHARTS.map((wanted) => ({ ...wanted, chart: new Chart(wanted) }));
    this.pictures = element("div", { class: "charts" }, this.charts.map(({ chart }) => chart.figure));
    place.replaceChildren(
      element("p", {}, element("a", { href: "#/" }, "All runs")),
      element("h1", {}, ids.length === 1 ? ids[0] : `${ids.length} runs`),
      ids.length === 1 ? element("p", {}, element("a", { href: `#/episodes/${encodeURIComponent(ids[0])}` }, "Watch its episodes")) : "",
      this.trouble, this.controls(), this.legend,
      this.pictures, this.processes?.place ?? "", this.facts,
    );
  }

  controls() {
    this.axes = AXES.map((axis) => button("", () => { this.looks.x = axis; this.draw(); }));
    this.nameAxes();
    const slider = element("input", {
      type: "range", min: 0, max: 0.98, step: 0.02, value: this.looks.weight,
      oninput: () => { this.looks.weight = Number(slider.value); this.draw(); },
    });
    const bands = element("input", {
      type: "checkbox", onchange: () => { this.looks.bands = bands.checked; this.draw(); },
    });
    return element("div", { class: "controls" },
      element("span", {}, "against"), this.axes,
      element("label", {}, "smoothing", slider),
      this.ids.length > 1 ? element("label", {}, bands, "seeds as bands") : null);
  }

  nameAxes() {
    this.axes.forEach((axis, index) => {
      axis.textContent = this.axisName(AXES[index]);
      axis.setAttribute("aria-pressed", String(AXES[index] === this.looks.x));
    });
  }

  /** Returns the name of an x axis. Runs without environment steps are drawn over their iterations. */
  axisName(axis) {
    if (axis === "wall_s") return "seconds";
    const begun = this.updates.filter(({ rows }) => rows.length > 0);
    const units = begun.map((updates) => (updates.takesSteps() ? "steps" : "iterations"));
    return [...new Set(units)].sort().join(" or ") || "steps";
  }

  /** Reads the runs again that have changed according to the list. */
  async show(list) {
    this.list = list;
    await this.refresh();
  }

  close() {
    this.isOpen = false;
    this.processes?.close();
  }

  async read() {
    const isChanged = ({ id }) => this.known.get(id) !== api.standing(this.list, id);
    const changed = this.updates.filter(isChanged);
    if (changed.length === 0 || !this.isOpen) return true;
    const isRead = [];
    for (const updates of changed) isRead.push(await this.readRun(updates));
    if (!this.isOpen) return true;
    const lines = [...this.troubles.values()].flat();
    renew(this.trouble, lines.map((line) => element("p", { class: "trouble" }, line)));
    if (this.ids.length > 1) {
      renew(this.facts, compared(this.updates.flatMap(({ details }) => details ?? [])));
    }
    this.pictures.hidden = this.updates.every((updates) => !updates.run);
    this.draw();
    return isRead.every(Boolean);
  }

  /** Reads a run; returns whether it could be read. */
  async readRun(updates) {
    const { id } = updates;
    const line = api.standing(this.list, id);
    try {
      await updates.read();
      const found = await api.details(id);
      [updates.run, updates.details] = [found.run, found];
      this.known.set(id, line);
      this.troubles.set(id, found.trouble);
      if (this.processes && this.isOpen) {
        renew(this.facts, facts(found));
        this.processes.follow(found.run.state === "training");
      }
      return true;
    } catch (error) {
      this.troubles.set(id, [`${id}: ${error.message}`]);
      if (line === "gone") this.processes?.follow(false);
      return false;
    }
  }

  draw() {
    this.nameAxes();
    const groups = this.groups();
    const names = groups.map(({ name, color }) => {
      const mark = element("span");
      mark.style.background = color;
      return element("li", {}, mark, name);
    });
    this.legend.replaceChildren(...(this.ids.length > 1 ? names : []));
    const xName = this.axisName(this.looks.x);
    for (const wanted of this.charts) {
      const marks = wanted.columns[0] === "success_rate" ? groups.flatMap(published) : [];
      wanted.chart.draw(groups.flatMap((group) => this.lines(group, wanted)), xName, marks);
    }
  }

  /** Returns the groups of runs that are drawn as one line: single runs, or those that differ only in their seeds. */
  groups() {
    const groups = [];
    for (const updates of this.updates) {
      const known = this.looks.bands && groups.find(([first]) => isSeedOfOneCurve(first, updates));
      if (known) known.push(updates);
      else groups.push([updates]);
    }
    const names = groups.map(([{ id, run }]) => (this.looks.bands && run ? `${run.task}, ${run.method}, ${run.preset}` : id));
    const isOnly = (name) => names.indexOf(name) === names.lastIndexOf(name);
    return groups.map((all, index) => ({
      name: isOnly(names[index]) ? names[index] : `${names[index]}, as ${all[0].id}`,
      all, color: `var(--c${index % COLORS})`,
    }));
  }

  lines({ name, all, color }, { columns, rate }) {
    return columns.map((column, index) => {
      const several = columns.length > 1 ? ` ${column.replaceAll("_", " ")}` : "";
      const found = all.map((updates) => points(updates, column, this.looks.x, rate));
      const own = this.ids.length > 1 ? name : "";
      const look = { name: `${own}${several}`.trim() || "value", color, dashed: index > 0 };
      if (all.length > 1) {
        const { mean, low, high, seeds } = band(found.map((line) => smoothed(line, this.looks.weight)));
        return { ...look, name: `${look.name} (${seeds} ${seeds === 1 ? "seed" : "seeds"})`, points: mean, low, high };
      }
      return { ...look, raw: this.looks.weight > 0 ? found[0] : null, points: smoothed(found[0], this.looks.weight) };
    });
  }
}

/** Returns whether two runs are seeds of one curve, according to the server. */
function isSeedOfOneCurve(one, other) {
  return one.details?.curve.some((name) => other.details?.curve.includes(name)) ?? false;
}

/** Returns a mark at the authors' published success, if it is the same for all runs of a group. */
function published({ all, color }) {
  const [first, ...others] = all.map(({ details }) => details?.published ?? null);
  if (first === null || others.some((other) => other?.rate !== first.rate)) return [];
  return [{ name: "Published by the authors", color, y: first.rate }];
}
