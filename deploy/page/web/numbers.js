// An episode shown as numbers: those of its observations as labeled curves.

import { Chart } from "./chart.js";
import { element } from "./dom.js";
import { short } from "./format.js";

const LINES = 8;
// Maximum number of curves; more would not be readable.
const MOST = 64;

/** Draws the numbers of observations, several per chart. */
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
