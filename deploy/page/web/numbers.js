// An episode of which only numbers are known: the observation's as curves, with their labels.

import { Chart } from "./chart.js";
import { element } from "./dom.js";
import { short } from "./format.js";

const LINES = 8;
// Curves of more numbers than these say nothing to anybody.
const MOST = 64;

/** Draws the numbers of observations, some to a chart. */
export class NumberStage {
  constructor() {
    this.place = element("div", { class: "numbers" });
    this.charts = [];
  }

  take({ task, values, steps }) {
    const length = task.observation.vector.len;
    const shown = Math.min(length, MOST);
    const line = (index) => ({
      name: task.labels?.[index] ?? `observation ${index}`,
      color: `var(--c${index % LINES})`,
      points: Array.from({ length: steps + 1 }, (_, step) => [step, values[step * length + index]]),
    });
    this.charts = [];
    for (let first = 0; first < shown; first += LINES) {
      const lines = Array.from({ length: Math.min(LINES, shown - first) }, (_, index) => line(first + index));
      const chart = new Chart({ title: lines.length > 1 ? `${lines[0].name} to ${lines.at(-1).name}` : lines[0].name });
      chart.draw(lines, "step");
      this.charts.push(chart);
    }
    const rest = length > shown ? [element("p", { class: "soft" }, `${short(length - shown)} more numbers are not drawn.`)] : [];
    this.place.replaceChildren(...this.charts.map((chart) => chart.figure), ...rest);
  }

  /** Shows a step. */
  show(step) {
    for (const chart of this.charts) chart.mark(step);
  }

  close() {}
}
