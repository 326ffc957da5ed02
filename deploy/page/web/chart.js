// A line chart with axes, lines, bands, a cursor that shows values, and export to files.

import { button, drawn, element, save } from "./dom.js";
import { percent, short } from "./format.js";
import { at, thinned } from "./series.js";

const [WIDTH, LEFT, RIGHT, TOP, BOTTOM] = [480, 52, 18, 10, 26];

/** A chart in its own figure element, 480 units wide. */
export class Chart {
  constructor({ title, share, height = 250 }) {
    [this.title, this.height] = [title, height];
    // A share of episodes or samples is drawn from 0 to 100 %.
    [this.least, this.most, this.show] = share ? [0, 1, percent] : [Infinity, -Infinity, short];
    [this.lines, this.told] = [[], null];
    // Called with the x at which the pointer is pressed.
    this.onpoint = null;
    this.readout = element("div", { class: "readout" });
    this.svg = drawn("svg", {
      class: "chart", viewBox: `0 0 ${WIDTH} ${height}`, tabindex: 0,
      onpointermove: (event) => this.point(event), onpointerdown: (event) => this.point(event), onpointerleave: () => this.leave(),
      onkeydown: (event) => this.step(event), onblur: () => this.leave(),
    });
    const files = [
      button("SVG", () => this.saveSvg(), { "aria-label": `Save ${title} as SVG` }),
      button("PNG", () => this.savePng(), { "aria-label": `Save ${title} as PNG` }),
      button("CSV", () => this.saveCsv(), { "aria-label": `Save ${title} as CSV` }),
    ];
    this.figure = element("figure", {},
      element("figcaption", {}, title, element("span", { class: "save" }, files)), this.svg, this.readout);
  }

  /**
   * Draws lines `{name, color, raw, points, low, high, dashed}` over an x axis named `xName`, and reference values
   * `{name, color, y}`, which are marked at the right.
   */
  draw(lines, xName, marks = []) {
    [this.lines, this.xName] = [lines.filter((line) => line.points.length > 0), xName];
    this.svg.setAttribute("aria-label", this.summary());
    // As a slider, the chart gets the arrow keys, and a screen reader says the values below the cursor.
    this.svg.setAttribute("role", this.lines.length > 0 ? "slider" : "img");
    if (this.lines.length === 0) {
      [this.told, this.readout.textContent] = [null, ""];
      this.svg.replaceChildren(words(WIDTH / 2, this.height / 2, "no values", "middle"));
      return;
    }
    this.range = this.ranges();
    const parts = [...marks.map((mark) => this.drawnMark(mark)), ...this.lines.flatMap((line) => this.drawnLine(line))];
    this.cursor = drawn("line", { y1: TOP, y2: this.height - BOTTOM, stroke: "var(--soft)", visibility: "hidden" });
    this.svg.replaceChildren(...this.axes(), ...parts, this.cursor);
    this.svg.setAttribute("aria-valuemin", this.range.left);
    this.svg.setAttribute("aria-valuemax", this.range.right);
    this.svg.setAttribute("aria-valuenow", this.range.left);
    if (this.told !== null) this.tell(this.told);
  }

  summary() {
    const ends = this.lines.map((line) => `${line.name} ends at ${this.show(line.points.at(-1)[1])}`);
    return `${this.title}. ${ends.join(", ") || "No values"}.`;
  }

  ranges() {
    const all = this.lines.flatMap((line) => [...line.points, ...(line.raw ?? []), ...(line.low ?? []), ...(line.high ?? [])]);
    let [left, right, low, high] = [Infinity, -Infinity, this.least, this.most];
    for (const [x, y] of all) {
      [left, right] = [Math.min(left, x), Math.max(right, x)];
      [low, high] = [Math.min(low, y), Math.max(high, y)];
    }
    // A range as small as rounding errors is widened.
    if (high - low <= 1e-9 * Math.max(Math.abs(low), Math.abs(high))) [low, high] = [low - 0.5, high + 0.5];
    return { left, right: right > left ? right : left + 1, low, high };
  }

  x(value) {
    const { left, right } = this.range;
    return LEFT + ((value - left) / (right - left)) * (WIDTH - LEFT - RIGHT);
  }

  y(value) {
    const { low, high } = this.range;
    return this.height - BOTTOM - ((value - low) / (high - low)) * (this.height - TOP - BOTTOM);
  }

  path(points) {
    return thinned(points).map(([x, y], i) => `${i ? "L" : "M"}${this.x(x).toFixed(1)} ${this.y(y).toFixed(1)}`).join("");
  }

  drawnLine({ color, raw, points, low, high, dashed }) {
    const stroke = { fill: "none", stroke: color, "stroke-linejoin": "round" };
    const parts = [];
    if (low?.length > 0) {
      const around = this.path(low) + this.path([...high].reverse()).replace("M", "L");
      parts.push(drawn("path", { d: `${around}Z`, fill: color, "fill-opacity": 0.18 }));
    }
    if (raw) parts.push(drawn("path", { ...stroke, d: this.path(raw), "stroke-opacity": 0.25 }));
    parts.push(drawn("path", {
      ...stroke, d: this.path(points), "stroke-width": 1.8, "stroke-dasharray": dashed ? "5 3" : null,
    }));
    return parts;
  }

  drawnMark({ name, color, y }) {
    const [right, height] = [WIDTH - RIGHT, this.y(y)];
    return drawn("g", { class: "mark" },
      drawn("title", {}, `${name}: ${this.show(y)}`),
      drawn("line", { x1: LEFT, x2: right, y1: height, y2: height, stroke: color, "stroke-dasharray": "2 5" }),
      drawn("path", { d: `M${right} ${height}l8 -5v10Z`, fill: color }));
  }

  axes() {
    const { left, right, low, high } = this.range;
    const rows = ticks(low, high, this.height / 50).flatMap((value) => [
      drawn("line", { x1: LEFT, x2: WIDTH - RIGHT, y1: this.y(value), y2: this.y(value), stroke: "var(--line)" }),
      words(LEFT - 6, this.y(value) + 4, this.show(value), "end"),
    ]);
    const columns = ticks(left, right, 5).map((value) => words(this.x(value), this.height - 8, short(value), "middle"));
    return [...rows, ...columns];
  }

  point(event) {
    if (this.lines.length === 0) return;
    const box = this.svg.getBoundingClientRect();
    const share = ((event.clientX - box.left) / box.width) * WIDTH;
    const { left, right } = this.range;
    const x = left + ((share - LEFT) / (WIDTH - LEFT - RIGHT)) * (right - left);
    this.tell(x);
    if (event.buttons > 0) this.onpoint?.(x);
  }

  step(event) {
    const direction = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!direction || this.lines.length === 0) return;
    event.preventDefault();
    const { left, right } = this.range;
    this.tell((this.told ?? right) + (direction * (right - left)) / 50);
  }

  tell(x) {
    const { left, right } = this.range;
    this.told = Math.min(Math.max(x, left), right);
    this.cursor.setAttribute("x1", this.x(this.told));
    this.cursor.setAttribute("x2", this.x(this.told));
    this.cursor.setAttribute("visibility", "inherit");
    const values = this.lines.map((line) => `${line.name} ${this.show(at(line.points, this.told))}`);
    this.readout.textContent = `${this.xName} ${short(this.told)}: ${values.join(" · ")}`;
    this.svg.setAttribute("aria-valuenow", this.told);
    this.svg.setAttribute("aria-valuetext", this.readout.textContent);
  }

  /** Keeps the cursor at `x`, for example at the step that is shown. */
  mark(x) {
    this.marked = x;
    if (this.lines.length > 0) this.tell(x);
  }

  leave() {
    if (this.marked !== undefined) {
      this.mark(this.marked);
      return;
    }
    this.told = null;
    this.readout.textContent = "";
    this.svg.removeAttribute("aria-valuetext");
    this.cursor?.setAttribute("visibility", "hidden");
  }

  /** Returns the chart as a standalone SVG file, with CSS variables replaced by their colors. */
  picture() {
    const copy = this.svg.cloneNode(true);
    copy.setAttribute("xmlns", "http://www.w3.org/2000/svg");
    copy.setAttribute("width", 2 * WIDTH);
    copy.setAttribute("height", 2 * this.height);
    copy.setAttribute("role", "img");
    const style = getComputedStyle(document.documentElement);
    const paper = drawn("rect", { width: WIDTH, height: this.height, fill: style.getPropertyValue("--paper") });
    copy.prepend(paper);
    const text = new XMLSerializer().serializeToString(copy);
    return text.replace(/var\((--[a-z0-9]+)\)/g, (_, name) => style.getPropertyValue(name).trim());
  }

  name(ending) {
    return `${this.title.toLowerCase().replace(/[^a-z0-9]+/g, "-")}.${ending}`;
  }

  saveSvg() {
    save(this.name("svg"), new Blob([this.picture()], { type: "image/svg+xml" }));
  }

  savePng() {
    const image = new Image();
    image.onload = () => {
      const canvas = element("canvas", { width: 2 * WIDTH, height: 2 * this.height });
      canvas.getContext("2d").drawImage(image, 0, 0);
      canvas.toBlob((blob) => save(this.name("png"), blob));
    };
    image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(this.picture())}`;
  }

  saveCsv() {
    const quoted = (name) => `"${name.replaceAll('"', '""')}"`;
    const rows = this.lines.flatMap((line) => (line.raw ?? line.points).map(([x, y]) => `${quoted(line.name)},${x},${y}`));
    const text = [`line,${this.xName},value`, ...rows].join("\n");
    save(this.name("csv"), new Blob([`${text}\n`], { type: "text/csv" }));
  }
}

function words(x, y, text, anchor) {
  const look = { "font-size": 11, "font-family": "system-ui, sans-serif", fill: "var(--soft)" };
  return drawn("text", { x, y, "text-anchor": anchor, ...look }, text);
}

function ticks(low, high, most) {
  const rough = (high - low) / most;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((size) => size >= rough);
  const found = [];
  for (let i = Math.ceil(low / step); i * step <= high + step * 1e-9; i += 1) found.push(i * step);
  return found;
}
