// An episode of a grid: colored cells, and a heat map of a model's proximity with the agent on each cell.

import { element } from "./dom.js";
import { short } from "./format.js";

const KNOWN = { wall: "--wall", goal: "--good", agent: "--agent", empty: "--raised" };
const CELL = 22;
// Ten equally spaced colors of viridis.
const VIRIDIS = [
  [68, 1, 84], [72, 40, 120], [62, 74, 137], [49, 104, 142], [38, 130, 142],
  [31, 158, 137], [53, 183, 121], [110, 206, 88], [181, 222, 43], [253, 231, 37],
];

/** Draws the observations of a grid. */
export class GridStage {
  constructor() {
    this.canvas = element("canvas", { role: "img" });
    this.legend = element("p", { class: "soft" });
    this.place = element("div", { class: "grid" }, this.canvas, this.legend);
    this.map = null;
    // A canvas keeps the colors that it was drawn with.
    this.themes = new MutationObserver(() => this.show(this.at));
    this.themes.observe(document.documentElement, { attributeFilter: ["data-theme"] });
  }

  take({ task, cells }) {
    const { height, width } = task.observation.cells;
    Object.assign(this, { height, width, cells, labels: task.labels ?? [], map: null, at: 0 });
    this.legend.textContent = "";
    [this.canvas.width, this.canvas.height] = [width * CELL, height * CELL];
    this.show(0);
  }

  /** Shows an observation. */
  show(step) {
    this.at = step;
    const [context, count] = [this.canvas.getContext("2d"), this.height * this.width];
    const seen = this.cells.slice(step * count, (step + 1) * count);
    const path = this.path(step);
    const style = getComputedStyle(this.canvas);
    this.colors = this.labels.map((label) => style.getPropertyValue(KNOWN[label] ?? "--soft"));
    seen.forEach((kind, place) => this.fill(context, place, this.color(kind, place)));
    context.strokeStyle = style.getPropertyValue("--agent");
    context.lineWidth = 2;
    context.beginPath();
    for (const place of path) context.lineTo(...this.center(place));
    context.stroke();
    const agent = seen.indexOf(this.labels.indexOf("agent"));
    this.canvas.setAttribute("aria-label",
      agent >= 0 ? `Step ${step}: agent in row ${Math.floor(agent / this.width)}, column ${agent % this.width}` : `Step ${step}`);
  }

  /** Returns the cells that the agent has visited up to a step. */
  path(step) {
    const [count, agent] = [this.height * this.width, this.labels.indexOf("agent")];
    const places = [];
    for (let i = 0; agent >= 0 && i <= step; i += 1) {
      const place = this.cells.indexOf(agent, i * count);
      if (place >= 0 && place < (i + 1) * count) places.push(place - i * count);
    }
    return places;
  }

  color(kind, place) {
    const value = this.map?.values.get(place);
    const isFree = this.labels[kind] === "empty" || !this.labels[kind];
    if (value === undefined || !isFree) return this.colors[kind] ?? shade(kind / 12);
    return shade((value - this.map.low) / (this.map.high - this.map.low || 1));
  }

  fill(context, place, color) {
    context.fillStyle = color;
    context.fillRect((place % this.width) * CELL, Math.floor(place / this.width) * CELL, CELL, CELL);
  }

  center(place) {
    return [(place % this.width + 0.5) * CELL, (Math.floor(place / this.width) + 0.5) * CELL];
  }

  /** Shows a model's proximity with the agent on each cell as a heat map, or removes it if `said` is null. */
  heat(said) {
    if (said === null) {
      [this.map, this.legend.textContent] = [null, ""];
    } else {
      // The color scale leaves out the goal's own cell, whose proximity is far above its neighbors'.
      const goal = this.labels.indexOf("goal");
      const others = said.places.map((place, index) => [place, said.proximity[index]]).filter(([place]) => this.cells[place] !== goal);
      const numbers = others.map(([, value]) => value);
      this.map = { values: new Map(others), low: Math.min(...numbers), high: Math.max(...numbers) };
      this.legend.textContent = `Proximity of the agent on each cell: dark ${short(this.map.low)}, light ${short(this.map.high)}`;
    }
    this.show(this.at);
  }

  close() {
    this.themes.disconnect();
  }
}

function shade(share) {
  const at = Math.min(Math.max(share, 0), 1) * (VIRIDIS.length - 1);
  const [low, rest] = [Math.floor(at), at % 1];
  const next = VIRIDIS[Math.min(low + 1, VIRIDIS.length - 1)];
  return `rgb(${VIRIDIS[low].map((part, index) => Math.round(part + rest * (next[index] - part))).join(" ")})`;
}
