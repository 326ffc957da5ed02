// The updates of runs as lines of charts: extracted, smoothed, and averaged over seeds.

import * as api from "./api.js";

// Steps over the x axis at which the lines of a band are compared.
const BAND_STEPS = 200;
// Points of a line that are drawn, about: more than a chart has pixels could not be told apart.
const DRAWN_POINTS = 600;

/** The updates of a run that have been read so far. */
export class Updates {
  constructor(id) {
    this.id = id;
    this.columns = [];
    this.rows = [];
    this.origin = null;
  }

  /** Reads new updates. */
  async read() {
    let found = await api.updates(this.id, this.rows.length);
    if (found.next < this.rows.length || (found.origin !== this.origin && this.rows.length > 0)) {
      // The run was resumed from an earlier checkpoint, or it is another run of the same name.
      this.rows = [];
      found = await api.updates(this.id, 0);
    }
    [this.columns, this.origin] = [found.columns, found.origin];
    for (const row of found.rows) this.rows.push(row);
  }

  /** Returns the numbers of a column. */
  column(name) {
    const place = this.columns.indexOf(name);
    return this.rows.map((row) => row[place]);
  }

  /** Returns whether the run takes environment steps; behavioral cloning does not. */
  takesSteps() {
    return this.column("environment_steps").some((steps) => steps > 0);
  }

  /** Returns the positions of the updates on an x axis: if there are no environment steps, the finished iterations. */
  positions(axis) {
    if (axis !== "environment_steps" || this.takesSteps()) return this.column(axis);
    return this.column("iteration").map((iteration) => iteration + 1);
  }
}

/** The charts: titles, and how their numbers are computed from the updates. */
export const CHARTS = [
  { title: "Success, last 100 training episodes", columns: ["success_rate"], share: true },
  { title: "Reward per step", columns: ["mean_reward"] },
  { title: "Proximity", columns: ["mean_proximity"] },
  { title: "Uncertainty", columns: ["mean_uncertainty"] },
  { title: "Episode length, steps", columns: ["mean_episode_steps"] },
  { title: "Entropy, nats", columns: ["entropy"] },
  { title: "Approximate KL, nats", columns: ["approximate_kl"] },
  { title: "Value loss", columns: ["value_loss"] },
  { title: "Policy loss", columns: ["policy_loss", "held_out_loss"] },
  { title: "Reward model's losses", columns: ["demonstration_loss", "agent_loss"] },
  { title: "Share of samples clipped", columns: ["clip_fraction"], share: true },
  { title: "Environment steps per second", columns: ["environment_steps"], rate: true },
];

/**
 * Returns the points of a column over `x`; for a rate, those of its increase per second of wall time, which a run
 * without environment steps does not have.
 */
export function points(updates, column, x, rate) {
  if (rate && !updates.takesSteps()) return [];
  const [horizontal, vertical] = [updates.positions(x), updates.column(column)];
  const times = rate ? updates.column("wall_s") : null;
  const found = [];
  for (let i = 0; i < vertical.length; i += 1) {
    let y = vertical[i];
    if (rate) {
      const passed = i > 0 ? times[i] - times[i - 1] : 0;
      y = passed > 0 ? (vertical[i] - vertical[i - 1]) / passed : null;
    }
    if (y !== null && y !== undefined && horizontal[i] !== null) found.push([horizontal[i], y]);
  }
  return found;
}

/** Returns a line's bias-corrected exponential moving average; `weight` in [0, 1) is that of the past. */
export function smoothed(line, weight) {
  let [sum, total] = [0, 0];
  return line.map(([x, y]) => {
    sum = weight * sum + y;
    total = weight * total + 1;
    return [x, sum / total];
  });
}

/**
 * Returns the mean and the range of several lines, over the x that all of them cover, and the number of lines. Lines of
 * fewer than two points are left out.
 */
export function band(lines) {
  const full = lines.filter((line) => line.length > 1);
  if (full.length === 0) return { mean: [], low: [], high: [], seeds: 0 };
  const first = Math.max(...full.map((line) => line[0][0]));
  const last = Math.min(...full.map((line) => line.at(-1)[0]));
  const found = { mean: [], low: [], high: [], seeds: full.length };
  for (let i = 0; i <= BAND_STEPS && last > first; i += 1) {
    const x = first + ((last - first) * i) / BAND_STEPS;
    const values = full.map((line) => at(line, x));
    found.mean.push([x, values.reduce((a, b) => a + b, 0) / values.length]);
    found.low.push([x, Math.min(...values)]);
    found.high.push([x, Math.max(...values)]);
  }
  return found;
}

/** Returns a line's height at `x`, interpolated linearly between its points. */
export function at(line, x) {
  const next = firstBehind(line, x);
  if (next === 0) return line[0][1];
  if (next === line.length) return line.at(-1)[1];
  const [[x0, y0], [x1, y1]] = [line[next - 1], line[next]];
  return y0 + ((y1 - y0) * (x - x0)) / (x1 - x0 || 1);
}

function firstBehind(line, x) {
  let [low, high] = [0, line.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (line[middle][0] > x) high = middle;
    else low = middle + 1;
  }
  return low;
}

/** Reduces a line to few points: its ends, and the lowest and the highest of each section. */
export function thinned(line) {
  if (line.length <= DRAWN_POINTS) return line;
  const stretch = Math.ceil(line.length / (DRAWN_POINTS / 2));
  const kept = [];
  for (let i = 0; i < line.length; i += stretch) {
    const part = line.slice(i, i + stretch);
    const low = part.reduce((a, b) => (b[1] < a[1] ? b : a));
    const high = part.reduce((a, b) => (b[1] > a[1] ? b : a));
    kept.push(...(low[0] <= high[0] ? [low, high] : [high, low]));
  }
  return [line[0], ...kept, line.at(-1)];
}
